//! When a certification stops, and how far it is.

/// When a certification stops.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoundSettings {
    /// The gap at which it stops, relative to the upper bound.
    pub gap: f64,
    /// The smallest side to which cells are split, metres.
    pub finest_cell_m: f64,
    /// The largest number of leaves that the missions are divided into.
    pub leaves_max: usize,
    /// The largest number of pairs of slot and cell that one leaf may store. It bounds the memory:
    /// about 10 bytes per pair while the leaf is processed, and 1 byte while it waits.
    pub pairs_max: usize,
    /// The number of comparisons of single numbers after which nothing is divided further. It bounds
    /// the time: about 10^9 take a second of one processor.
    pub work_max: usize,
}

impl Default for BoundSettings {
    fn default() -> Self {
        Self {
            gap: 0.005,
            finest_cell_m: 0.2,
            leaves_max: 4000,
            pairs_max: 40_000_000,
            work_max: 100_000_000_000,
        }
    }
}

/// The progress of a certification.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoundProgress {
    /// The side of the present cells, metres.
    pub cell_m: f64,
    /// The number of leaves that the missions are divided into.
    pub leaves: usize,
    /// The best upper bound so far, bit/s/Hz.
    pub upper: f64,
    /// The value of the best mission so far, bit/s/Hz.
    pub lower: f64,
}
