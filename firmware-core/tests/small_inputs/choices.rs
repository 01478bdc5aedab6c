// SPDX-License-Identifier: MIT OR Apache-2.0
//! All combinations of a few values.

/// The choices of one run of a harness.
#[derive(Debug, Default)]
pub(crate) struct Choices {
    /// What was chosen so far in this run, or will be again: the index and the number of values.
    #[cfg(not(kani))]
    chosen: Vec<(usize, usize)>,
    #[cfg(not(kani))]
    next: usize,
}

impl Choices {
    /// Returns each number below `end` in some run.
    #[cfg(not(kani))]
    pub(crate) fn below(&mut self, end: usize) -> usize {
        if self.next == self.chosen.len() {
            self.chosen.push((0, end));
        }
        let (index, known_end) = self.chosen[self.next];
        assert_eq!(
            known_end, end,
            "a choice depends on more than earlier choices"
        );
        self.next += 1;
        index
    }

    /// Returns any number below `end`.
    #[cfg(kani)]
    pub(crate) fn below(&mut self, end: usize) -> usize {
        let index = kani::any();
        kani::assume(index < end);
        index
    }

    /// Returns each of the values in some run.
    pub(crate) fn of<T: Copy>(&mut self, values: &[T]) -> T {
        values[self.below(values.len())]
    }

    /// Returns each list of up to `longest` of the values in some run.
    pub(crate) fn list<T: Copy>(&mut self, longest: usize, values: &[T]) -> Vec<T> {
        let length = self.below(longest + 1);
        (0..length).map(|_| self.of(values)).collect()
    }

    /// Goes on to the next combination. Returns false after the last one.
    #[cfg(not(kani))]
    fn advance(&mut self) -> bool {
        self.next = 0;
        while let Some((index, end)) = self.chosen.pop() {
            if index + 1 < end {
                self.chosen.push((index + 1, end));
                return true;
            }
        }
        false
    }
}

/// Runs a harness for every combination of its choices and returns their number.
#[cfg(not(kani))]
pub(crate) fn each(harness: impl Fn(&mut Choices)) -> u64 {
    let mut choices = Choices::default();
    let mut runs = 0;
    loop {
        harness(&mut choices);
        runs += 1;
        if !choices.advance() {
            return runs;
        }
    }
}

/// Runs a harness for all combinations of its choices at once.
#[cfg(kani)]
pub(crate) fn each(harness: impl Fn(&mut Choices)) {
    harness(&mut Choices::default());
}

#[cfg(not(kani))]
#[test]
fn every_combination_is_chosen_once() {
    let seen = std::cell::RefCell::new(std::collections::BTreeSet::new());
    let runs = each(|choices| {
        let list = choices.list(2, &['a', 'b', 'c']);
        let more = if list.len() == 1 { choices.below(2) } else { 0 };
        assert!(seen.borrow_mut().insert((list, more)));
    });
    assert_eq!(runs, 1 + 3 * 2 + 9);
}
