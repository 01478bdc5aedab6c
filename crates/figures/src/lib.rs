//! What figures and pages are made of. Reports of flights, the page of experiments and the cards of
//! policies all use it; nothing here knows what they show.
//!
//! * [`markup`]: elements of SVG and HTML, escaped when they are written.
//! * [`axis`]: from values to places in a drawing, with round ticks; legends; the figure itself.
//! * [`placement`]: labels beside marks without covering them.
//! * [`quantity`]: numbers as people read them.
//! * [`theme`]: colours and style sheets, for light and dark.
//! * [`document`]: tables that commands write into documents.

#![deny(missing_docs)]

pub mod axis;
pub mod document;
pub mod markup;
pub mod placement;
pub mod quantity;
pub mod theme;
