//! A number that a file gives once for all users or sensors, or once for each.

use std::fmt;

use serde::{
    Deserialize, Deserializer, Serialize,
    de::{SeqAccess, Visitor},
};

/// One number for all nodes of a kind, or a list with a number for each. In a file: a number, or a
/// list.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum PerNode {
    /// The same for all.
    All(f64),
    /// One each, in the order of their numbers.
    Each(Vec<f64>),
}

impl Default for PerNode {
    fn default() -> Self {
        Self::All(0.0)
    }
}

impl PerNode {
    /// Returns the numbers that are given: one, or one each.
    pub fn values(&self) -> &[f64] {
        match self {
            Self::All(value) => std::slice::from_ref(value),
            Self::Each(values) => values,
        }
    }

    /// Returns the number of a node. One that is not in the list, because it joined in flight, has
    /// the mean of the others.
    pub fn of(&self, node: usize) -> f64 {
        let values = self.values();
        match (self, values.get(node)) {
            (Self::All(value), _) => *value,
            (Self::Each(_), Some(value)) => *value,
            (Self::Each(_), None) => values.iter().sum::<f64>() / values.len().max(1) as f64,
        }
    }

    /// Returns whether every number is 0.
    pub fn is_zero(&self) -> bool {
        self.values().iter().all(|value| *value == 0.0)
    }
}

impl<'de> Deserialize<'de> for PerNode {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct NumberOrList;

        impl<'de> Visitor<'de> for NumberOrList {
            type Value = PerNode;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number or a list of numbers")
            }

            fn visit_f64<E>(self, value: f64) -> Result<PerNode, E> {
                Ok(PerNode::All(value))
            }

            fn visit_u64<E>(self, value: u64) -> Result<PerNode, E> {
                Ok(PerNode::All(value as f64))
            }

            fn visit_i64<E>(self, value: i64) -> Result<PerNode, E> {
                Ok(PerNode::All(value as f64))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<PerNode, A::Error> {
                let mut values = Vec::new();
                while let Some(value) = list.next_element()? {
                    values.push(value);
                }
                Ok(PerNode::Each(values))
            }
        }

        deserializer.deserialize_any(NumberOrList)
    }
}
