//! Tables of statistics, for the terminal, for documents and for pages.

use figures::markup::{Element, element};
use scenario::EventKind;
use simulation::benchmark::{ChangeStatistics, GroupStatistics, PolicyStatistics};

/// A table with one row per policy, or per policy and group of missions or kind of change.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    columns: Vec<String>,
    rows: Vec<Vec<String>>,
    /// The number of columns, from the first on, that hold words. The others hold numbers.
    words: usize,
}

impl Table {
    /// Creates the table of policies. The fraction of the ideal vehicle's total has a column if it is
    /// known.
    pub fn of_policies(found: &[PolicyStatistics]) -> Self {
        let of_ideal = found.iter().any(|row| !row.ideal_mean.is_nan());
        let mut columns = vec![
            "policy",
            "flown",
            "counted",
            "mean",
            "5 %",
            "worst",
            "reference",
        ];
        columns.extend(of_ideal.then_some("of ideal"));
        columns.extend([
            "violated",
            "inaccurate",
            "prepare s",
            "at most",
            "decide us",
        ]);
        let row = |row: &PolicyStatistics| {
            let mut cells = vec![
                row.policy.clone(),
                row.flown.to_string(),
                row.counted.to_string(),
                number(row.mean, 4),
                number(row.quantile_5, 4),
                number(row.worst, 4),
                number(row.reference_mean, 4),
            ];
            cells.extend(of_ideal.then(|| number(row.ideal_mean, 4)));
            cells.extend([
                row.violations.to_string(),
                row.inaccurate_slots.to_string(),
                number(row.preparation_median_s, 3),
                number(row.preparation_max_s, 3),
                number(row.decision_median_us, 1),
            ]);
            cells
        };
        Self::new(1, &columns, found.iter().map(row).collect())
    }

    /// Creates the table of groups of missions.
    pub fn of_groups(found: &[GroupStatistics]) -> Self {
        let row = |row: &GroupStatistics| {
            let found = &row.statistics;
            vec![
                row.group.clone(),
                found.policy.clone(),
                found.counted.to_string(),
                number(found.mean, 4),
                number(found.quantile_5, 4),
                number(found.worst, 4),
                found.violations.to_string(),
            ]
        };
        let columns = [
            "missions", "policy", "counted", "mean", "5 %", "worst", "violated",
        ];
        Self::new(2, &columns, found.iter().map(row).collect())
    }

    fn new(words: usize, columns: &[&str], rows: Vec<Vec<String>>) -> Self {
        Self {
            columns: columns.iter().copied().map(str::to_owned).collect(),
            rows,
            words,
        }
    }

    /// Creates the table of missions that change in flight. `reference` is the policy with whose
    /// totals the others are compared.
    pub fn of_changes(found: &[ChangeStatistics], reference: &str) -> Self {
        let row = |row: &ChangeStatistics| {
            vec![
                row.kind.map_or("all of these", EventKind::title).to_owned(),
                row.policy.clone(),
                row.flown.to_string(),
                number(row.mean, 4),
                number(row.worst, 4),
                number(row.reference_mean, 4),
                number(row.reference_worst, 4),
                row.violations.to_string(),
            ]
        };
        let of_reference = format!("of {reference}");
        let columns = [
            "at mid-mission",
            "policy",
            "flown",
            "mean",
            "worst",
            of_reference.as_str(),
            "at least",
            "violated",
        ];
        Self::new(2, &columns, found.iter().map(row).collect())
    }

    /// Returns the table in columns of text.
    pub fn to_text(&self) -> String {
        let headings = &self.columns;
        let lines = || [headings].into_iter().chain(&self.rows);
        let width = |column: usize| lines().map(|row| row[column].len()).max().unwrap_or(0);
        let widths: Vec<usize> = (0..headings.len()).map(width).collect();
        let mut text = String::new();
        for row in lines() {
            for (column, (cell, width)) in row.iter().zip(&widths).enumerate() {
                let gap = if column == 0 { "" } else { "  " };
                text += &if column < self.words {
                    format!("{gap}{cell:<width$}")
                } else {
                    format!("{gap}{cell:>width$}")
                };
            }
            text.push('\n');
        }
        text
    }

    /// Returns the table in Markdown.
    pub fn to_markdown(&self) -> String {
        let numbers = self.columns.len() - self.words;
        let alignment = ["---|".repeat(self.words), "--:|".repeat(numbers)].concat();
        let mut text = format!("| {} |\n|{alignment}\n", self.columns.join(" | "));
        for row in &self.rows {
            text += &format!("| {} |\n", row.join(" | "));
        }
        text
    }

    /// Returns the table for a page. It scrolls where it is too wide.
    pub fn to_element(&self) -> Element {
        let row = |kind: &'static str, cells: &mut dyn Iterator<Item = &str>| {
            let cells = cells.enumerate().map(|(column, text)| {
                let cell = element(kind).text(text.to_owned());
                if column < self.words {
                    cell.class("said")
                } else {
                    cell
                }
            });
            element("tr").with_all(cells.collect::<Vec<_>>())
        };
        let head = row("th", &mut self.columns.iter().map(String::as_str));
        let body = self
            .rows
            .iter()
            .map(|cells| row("td", &mut cells.iter().map(String::as_str)));
        element("div").class("scroll").with(
            element("table")
                .class("slots")
                .with(element("thead").with(head))
                .with(element("tbody").with_all(body)),
        )
    }
}

/// Formats a number, or a dash where there is none.
fn number(value: f64, decimals: usize) -> String {
    if value.is_nan() {
        "-".to_owned()
    } else {
        format!("{value:.decimals$}")
    }
}
