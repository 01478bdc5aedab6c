//! Places labels beside marks so that they cover neither marks nor each other. The algorithm is
//! greedy and tries eight positions per label.

use crate::axis::text_width;

/// The areas of a drawing that are already occupied.
#[derive(Clone, Debug)]
pub struct Placement {
    bounds: Box,
    taken: Vec<Box>,
}

#[derive(Clone, Copy, Debug)]
struct Box {
    left: f64,
    top: f64,
    right: f64,
    bottom: f64,
}

/// The position of a label: the reference point on its base line, and how it is aligned there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spot {
    /// The reference point.
    pub at: [f64; 2],
    /// Which part of the text is at the reference point.
    pub align: Align,
    /// The occupied area that the label covers, square units: 0 if there was enough space.
    pub covered: f64,
}

/// Which part of the text is at the reference point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Align {
    /// The text begins at the reference point.
    Start,
    /// The middle of the text is at the reference point.
    Middle,
    /// The text ends at the reference point.
    End,
}

impl Placement {
    /// Creates an empty drawing. Labels must stay within these corners.
    pub fn within([left, top]: [f64; 2], [right, bottom]: [f64; 2]) -> Self {
        Self {
            bounds: Box {
                left,
                top,
                right,
                bottom,
            },
            taken: Vec::new(),
        }
    }

    /// Adds a mark that labels must not cover.
    pub fn take(&mut self, center: [f64; 2], radius: f64) {
        // The margin is needed because a text that touches the next mark seems to belong to it.
        let extent = radius + 2.0;
        self.taken.push(Box::around(center, [extent, extent]));
    }

    /// Returns the best position for a text of this size beside a mark, and occupies it.
    pub fn place(&mut self, mark: [f64; 2], radius: f64, words: &str, size: f64) -> Spot {
        let spot = self.best(mark, radius, words, size);
        self.taken.push(spot.covering(words, size));
        spot
    }

    /// Does the same as [`place`](Self::place), but only if a position is entirely free.
    pub fn place_if_free(
        &mut self,
        mark: [f64; 2],
        radius: f64,
        words: &str,
        size: f64,
    ) -> Option<Spot> {
        let spot = self.best(mark, radius, words, size);
        (spot.covered <= 0.0).then(|| {
            self.taken.push(spot.covering(words, size));
            spot
        })
    }

    fn best(&self, [x, y]: [f64; 2], radius: f64, words: &str, size: f64) -> Spot {
        let gap = radius + 3.5;
        let slant = radius * 0.7 + 3.0;
        // Capital letters are about 0.72 of the size high, so shifting by `drop` centres them on a
        // point.
        let drop = size * 0.36;
        let candidates = [
            ([x + gap, y + drop], Align::Start),
            ([x - gap, y + drop], Align::End),
            ([x, y - gap], Align::Middle),
            ([x, y + gap + 2.0 * drop], Align::Middle),
            ([x + slant, y - slant], Align::Start),
            ([x + slant, y + slant + 2.0 * drop], Align::Start),
            ([x - slant, y - slant], Align::End),
            ([x - slant, y + slant + 2.0 * drop], Align::End),
        ];
        let mut best = Spot {
            at: [x, y],
            align: Align::Start,
            covered: f64::INFINITY,
        };
        for (at, align) in candidates {
            let mut spot = Spot {
                at,
                align,
                covered: 0.0,
            };
            let own = spot.covering(words, size);
            let overlaps = self.taken.iter().map(|taken| taken.overlap(&own));
            // A label that extends beyond the drawing is worse than any overlap.
            let outside = own.area() - own.overlap(&self.bounds);
            spot.covered = overlaps.sum::<f64>() + 100.0 * outside.max(0.0);
            // Rounding must not decide between two positions that are equally free.
            if spot.covered < best.covered - 1e-6 {
                best = spot;
            }
        }
        best
    }
}

impl Spot {
    fn covering(&self, words: &str, size: f64) -> Box {
        let [x, y] = self.at;
        let width = text_width(words, size);
        let left = match self.align {
            Align::Start => x,
            Align::Middle => x - width / 2.0,
            Align::End => x - width,
        };
        Box {
            left,
            right: left + width,
            top: y - 0.78 * size,
            bottom: y + 0.06 * size,
        }
    }
}

impl Box {
    fn around([x, y]: [f64; 2], [half_width, half_height]: [f64; 2]) -> Self {
        Self {
            left: x - half_width,
            right: x + half_width,
            top: y - half_height,
            bottom: y + half_height,
        }
    }

    fn area(&self) -> f64 {
        (self.right - self.left) * (self.bottom - self.top)
    }

    fn overlap(&self, other: &Self) -> f64 {
        let width = self.right.min(other.right) - self.left.max(other.left);
        let height = self.bottom.min(other.bottom) - self.top.max(other.top);
        if width > 0.0 && height > 0.0 {
            width * height
        } else {
            0.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_avoid_marks_and_one_another() {
        let mut placement = Placement::within([0.0, 0.0], [400.0, 400.0]);
        let marks: Vec<[f64; 2]> = (0..12)
            .map(|n| {
                [
                    60.0 + 70.0 * f64::from(n % 4),
                    90.0 + 60.0 * f64::from(n / 4),
                ]
            })
            .collect();
        marks.iter().for_each(|mark| placement.take(*mark, 5.0));
        for mark in marks {
            assert_eq!(placement.place(mark, 5.0, "u11", 11.0).covered, 0.0);
        }
    }

    #[test]
    fn labels_stay_inside_and_give_way_when_asked() {
        let mut placement = Placement::within([0.0, 0.0], [100.0, 100.0]);
        let spot = placement.place([98.0, 50.0], 4.0, "destination", 12.0);
        assert_eq!(spot.align, Align::End);
        placement.take([50.0, 50.0], 200.0);
        assert_eq!(placement.place_if_free([50.0, 50.0], 4.0, "7", 10.0), None);
    }
}
