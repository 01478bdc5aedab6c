//! What an agent does in a slot.

use rand::{Rng, RngExt};

/// A set of users: bit `m` is set if user `m` belongs to it.
pub type UserSet = u64;

/// An agent's action in one state.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Action {
    /// The continuous components, each in `[-1, 1]`. The first two are the displacement east and
    /// north in units of `V_max delta`; an algorithm may append components of its own, which the
    /// environment ignores.
    pub components: Vec<f32>,
    /// The index of the user to serve.
    pub user: usize,
}

impl Action {
    /// Replaces this action by a uniformly random one with `len` components and one of the
    /// admissible users; user 0 is chosen if the set is empty.
    pub fn randomize(&mut self, len: usize, users: usize, admissible: UserSet, rng: &mut impl Rng) {
        self.randomize_components(len, rng);
        let count = (0..users).filter(|m| admissible >> m & 1 == 1).count();
        let nth = rng.random_range(0..count.max(1));
        let mut admitted = (0..users).filter(|m| admissible >> m & 1 == 1);
        self.user = admitted.nth(nth).unwrap_or(0);
    }

    /// Replaces the components by `len` uniformly random ones and leaves the user unchanged.
    pub fn randomize_components(&mut self, len: usize, rng: &mut impl Rng) {
        self.components.clear();
        self.components
            .extend((0..len).map(|_| rng.random_range(-1.0_f32..1.0)));
    }
}
