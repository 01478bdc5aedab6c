//! Numbers of runs or array tasks, as the text that HyperQueue and Slurm take.

use std::fmt::Write as _;

/// Returns numbers in ascending order as ranges: `1-3,5`.
pub fn ranges(numbers: &[usize]) -> String {
    let mut text = String::new();
    let mut rest = numbers;
    while let Some(&first) = rest.first() {
        let following = rest.iter().zip(first..).take_while(|(a, b)| **a == *b);
        let length = following.count();
        let last = first + length - 1;
        if !text.is_empty() {
            text.push(',');
        }
        // Writing to a string cannot fail.
        let _ = match length {
            1 => write!(text, "{first}"),
            _ => write!(text, "{first}-{last}"),
        };
        rest = &rest[length..];
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn successive_numbers_are_ranges() {
        assert_eq!(ranges(&[]), "");
        assert_eq!(ranges(&[4]), "4");
        assert_eq!(ranges(&[1, 2, 3, 5, 7, 8]), "1-3,5,7-8");
    }
}
