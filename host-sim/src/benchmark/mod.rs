//! The benchmark of policies as tables and as a page. What it flies and how it scores is in
//! [`simulation::benchmark`], which the Python package shares.

mod page;
mod table;

pub use page::page;
pub use simulation::benchmark::*;
pub use table::Table;
