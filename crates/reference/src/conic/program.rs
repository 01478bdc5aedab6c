//! A cone program in Clarabel's standard form, and the interpretation of Clarabel's statuses.

use clarabel::{
    algebra::CscMatrix,
    solver::{DefaultSettings, DefaultSolver, IPSolver, SolverStatus, SupportedConeT},
};

/// Returns whether Clarabel reports an optimum, to full or reduced accuracy.
pub(super) fn is_solution(status: SolverStatus) -> bool {
    matches!(status, SolverStatus::Solved | SolverStatus::AlmostSolved)
}

/// Returns whether Clarabel reports that there is no feasible point.
pub(super) fn is_infeasible(status: SolverStatus) -> bool {
    matches!(
        status,
        SolverStatus::PrimalInfeasible | SolverStatus::AlmostPrimalInfeasible
    )
}

/// A conic problem under construction: minimize `objective x` with `b - A x` in the cones.
#[derive(Debug)]
pub(super) struct Program {
    /// The objective, with one coefficient per variable.
    pub(super) objective: Vec<f64>,
    rows: Vec<usize>,
    columns: Vec<usize>,
    values: Vec<f64>,
    right: Vec<f64>,
    cones: Vec<SupportedConeT<f64>>,
}

impl Program {
    /// Creates a program without rows and with a zero objective.
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

    /// Adds a row `(A, b)`: `right` minus the sum of `terms` must be in the cone that is added
    /// next.
    pub(super) fn row(&mut self, terms: &[(usize, f64)], right: f64) {
        for &(column, value) in terms {
            self.rows.push(self.right.len());
            self.columns.push(column);
            self.values.push(value);
        }
        self.right.push(right);
    }

    /// Adds the cone of the rows since the last cone.
    pub(super) fn cone(&mut self, cone: SupportedConeT<f64>) {
        self.cones.push(cone);
    }

    /// Returns Clarabel's status and the point where it stopped, which must be checked by the
    /// caller. Retries with shorter steps if Clarabel's own end in a corner of the exponential
    /// cone.
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
            // The dimensions are set by this module, and the constructor has no other reason to
            // fail.
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
