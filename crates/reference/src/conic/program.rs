//! A cone program in Clarabel's standard form, and what its statuses mean.

use clarabel::{
    algebra::CscMatrix,
    solver::{DefaultSettings, DefaultSolver, IPSolver, SolverStatus, SupportedConeT},
};

/// Optimal to full or reduced accuracy, says Clarabel.
pub(super) fn is_solution(status: SolverStatus) -> bool {
    matches!(status, SolverStatus::Solved | SolverStatus::AlmostSolved)
}

/// Without a feasible point, says Clarabel.
pub(super) fn is_infeasible(status: SolverStatus) -> bool {
    matches!(
        status,
        SolverStatus::PrimalInfeasible | SolverStatus::AlmostPrimalInfeasible
    )
}

/// A conic problem under construction: least `objective x` with `b - A x` in the cones.
#[derive(Debug)]
pub(super) struct Program {
    /// One coefficient per variable.
    pub(super) objective: Vec<f64>,
    rows: Vec<usize>,
    columns: Vec<usize>,
    values: Vec<f64>,
    right: Vec<f64>,
    cones: Vec<SupportedConeT<f64>>,
}

impl Program {
    /// No rows yet, and nothing to minimise.
    pub(super) fn new(variables: usize) -> Self {
        Self {
            objective: vec![0.0; variables],
            rows: Vec::new(),
            columns: Vec::new(),
            values: Vec::new(),
            right: Vec::new(),
            cones: Vec::new(),
        }
    }

    /// A row `(A, b)`: `right - sum of terms` is in the cone that is stated next.
    pub(super) fn row(&mut self, terms: &[(usize, f64)], right: f64) {
        for &(column, value) in terms {
            self.rows.push(self.right.len());
            self.columns.push(column);
            self.values.push(value);
        }
        self.right.push(right);
    }

    /// The rows since the last cone are in this one.
    pub(super) fn cone(&mut self, cone: SupportedConeT<f64>) {
        self.cones.push(cone);
    }

    /// What Clarabel says, and where it stopped; not to be trusted without a look at the point.
    /// Tries shorter steps where Clarabel's own end in a corner of the exponential cone.
    pub(super) fn solve(self, tolerance: f64) -> (SolverStatus, Vec<f64>) {
        let variables = self.objective.len();
        let quadratic = CscMatrix::zeros((variables, variables));
        let constraints = CscMatrix::new_from_triplets(
            self.right.len(),
            variables,
            self.rows,
            self.columns,
            self.values,
        );
        let mut found = (SolverStatus::Unsolved, vec![f64::NAN; variables]);
        for (max_step_fraction, equilibrate_enable) in [(0.99, true), (0.8, true), (0.8, false)] {
            let settings = DefaultSettings {
                verbose: false,
                tol_gap_abs: tolerance,
                tol_gap_rel: tolerance,
                tol_feas: tolerance,
                max_step_fraction,
                equilibrate_enable,
                ..DefaultSettings::default()
            };
            // Dimensions are this module's own: the constructor has nothing else to refuse.
            if let Ok(mut solver) = DefaultSolver::new(
                &quadratic,
                &self.objective,
                &constraints,
                &self.right,
                &self.cones,
                settings,
            ) {
                solver.solve();
                found = (solver.solution.status, solver.solution.x.clone());
            }
            if is_solution(found.0) || is_infeasible(found.0) {
                break;
            }
        }
        found
    }
}
