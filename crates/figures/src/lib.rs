//! The building blocks of figures and pages. Reports of flights, the page of experiments and the
//! cards of policies all use them. Nothing in this crate depends on the content that is shown.
//!
//! * [`markup`]: elements of SVG and HTML, escaped when they are written.
//! * [`axis`]: scales with round ticks, axes, legends, and the figure itself.
//! * [`chart`]: whole charts of series in panels, with axes and one legend.
//! * [`series`]: what a chart shows: lines, marks, bands and texts, distinguishable without colour.
//! * [`page`]: whole pages with their head and style sheet.
//! * [`placement`]: places labels beside marks without covering them.
//! * [`quantity`]: formats numbers for people.
//! * [`theme`]: colours and style sheets, for light and dark.
//! * [`document`]: tables that commands write into documents.

#![deny(missing_docs)]

pub mod axis;
pub mod chart;
pub mod document;
pub mod markup;
pub mod page;
pub mod placement;
pub mod quantity;
pub mod series;
pub mod theme;
