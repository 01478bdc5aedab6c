//! Elementary operators, with names that count up.

use super::super::graph::{Graph, integer, integers};
use firmware_core::policy::sets::{Precision, features::LIMIT, half};

/// A graph whose intermediate values are numbered.
#[derive(Debug, Default)]
pub(super) struct Operators {
    pub(super) graph: Graph,
    values: usize,
}

impl Operators {
    fn name(&mut self, op: &str) -> String {
        self.values += 1;
        format!("{}_{}", op.to_lowercase(), self.values)
    }

    /// Returns the output of an operator.
    pub(super) fn apply(&mut self, op: &str, inputs: &[&str]) -> String {
        let name = self.name(op);
        self.graph.node(op, inputs, &name)
    }

    /// Returns the output of an operator with respect to an axis.
    pub(super) fn along(&mut self, op: &str, inputs: &[&str], axis: i64) -> String {
        let name = self.name(op);
        let attributes = vec![integer("axis", axis)];
        self.graph.node_with(op, inputs, &[&name], attributes);
        name
    }

    /// Returns `ReduceMean` or `ReduceMax` over an axis, which keeps the length 1.
    pub(super) fn reduce(&mut self, op: &str, input: &str, axis: i64) -> String {
        let name = self.name(op);
        let attributes = vec![integers("axes", &[axis]), integer("keepdims", 1)];
        self.graph.node_with(op, &[input], &[&name], attributes);
        name
    }

    /// Returns the sum over an axis, which keeps the length 1.
    pub(super) fn sum(&mut self, input: &str, axis: i64) -> String {
        let axes = self.integers(&[axis]);
        let name = self.name("ReduceSum");
        let attributes = vec![integer("keepdims", 1)];
        self.graph
            .node_with("ReduceSum", &[input, &axes], &[&name], attributes);
        name
    }

    /// Returns the index of the largest entry over an axis, the first of equals.
    pub(super) fn first_largest(&mut self, input: &str, axis: i64) -> String {
        let name = self.name("ArgMax");
        let attributes = vec![integer("axis", axis), integer("keepdims", 1)];
        self.graph
            .node_with("ArgMax", &[input], &[&name], attributes);
        name
    }

    /// Returns 1 where integers are equal, and 0 elsewhere.
    pub(super) fn equal(&mut self, a: &str, b: &str) -> String {
        let equal = self.apply("Equal", &[a, b]);
        let name = self.name("Cast");
        let attributes = vec![integer("to", super::super::proto::FLOAT.into())];
        self.graph
            .node_with("Cast", &[&equal], &[&name], attributes);
        name
    }

    /// Returns a value with its axes in another order.
    pub(super) fn transpose(&mut self, input: &str, order: &[i64]) -> String {
        let name = self.name("Transpose");
        let attributes = vec![integers("perm", order)];
        self.graph
            .node_with("Transpose", &[input], &[&name], attributes);
        name
    }

    /// Returns a value of another shape with the same elements.
    pub(super) fn reshape(&mut self, input: &str, dims: &[i64]) -> String {
        let dims = self.integers(dims);
        self.apply("Reshape", &[input, &dims])
    }

    /// Returns parts of equal length along the last axis.
    pub(super) fn thirds(&mut self, input: &str, length: i64) -> [String; 3] {
        let lengths = self.integers(&[length; 3]);
        let names = [(); 3].map(|()| self.name("Split"));
        let [a, b, c] = &names;
        let attributes = vec![integer("axis", -1)];
        self.graph
            .node_with("Split", &[input, &lengths], &[a, b, c], attributes);
        names
    }

    /// Returns the entries from `begin` to `end` along an axis.
    pub(super) fn slice(&mut self, input: &str, axis: i64, begin: i64, end: i64) -> String {
        let bounds = [begin, end, axis].map(|bound| self.integers(&[bound]));
        let [begin, end, axis] = &bounds;
        self.apply("Slice", &[input, begin, end, axis])
    }

    /// Returns a constant with one element that has three axes.
    pub(super) fn number(&mut self, value: f32) -> String {
        let name = self.name("number");
        self.graph.constant(&name, &[1, 1, 1], &[value])
    }

    fn scalar(&mut self, value: f32) -> String {
        let name = self.name("scalar");
        self.graph.constant(&name, &[], &[value])
    }

    pub(super) fn integers(&mut self, values: &[i64]) -> String {
        let name = self.name("integers");
        self.graph.integers(&name, values)
    }

    /// Returns a value that a number is added to, subtracted from and so on.
    pub(super) fn with_number(&mut self, op: &str, input: &str, value: f32) -> String {
        let value = self.number(value);
        self.apply(op, &[input, &value])
    }

    /// Returns a value limited to the range of features.
    pub(super) fn clip(&mut self, input: &str) -> String {
        let [low, high] = [-LIMIT, LIMIT].map(|bound| self.scalar(bound));
        self.apply("Clip", &[input, &low, &high])
    }

    /// Returns `input / max(divisor, least)`.
    pub(super) fn divide_at_least(&mut self, input: &str, divisor: &str, least: f32) -> String {
        let divisor = self.with_number("Max", divisor, least);
        self.apply("Div", &[input, &divisor])
    }

    /// Returns `x / (1 + exp(-x))`.
    pub(super) fn silu(&mut self, input: &str) -> String {
        let sigmoid = self.apply("Sigmoid", &[input]);
        self.apply("Mul", &[input, &sigmoid])
    }

    /// Adds weights, in single precision after they are read.
    pub(super) fn weights(
        &mut self,
        name: &str,
        dims: &[i64],
        values: &[f32],
        precision: Precision,
    ) -> String {
        match precision {
            Precision::Single => self.graph.constant(name, dims, values),
            Precision::Half => {
                let bits: Vec<u16> = values.iter().map(|&x| half::from_single(x)).collect();
                let halves = self.graph.halves(name, dims, &bits);
                let single = format!("{name}.single");
                let attributes = vec![integer("to", super::super::proto::FLOAT.into())];
                self.graph
                    .node_with("Cast", &[&halves], &[&single], attributes);
                single
            }
        }
    }
}
