//! `index.html`: one page with every figure, the paper's claims about it and the verdicts.

use std::path::Path;

use crate::experiment::{Experiment, claims::Claim, table};
use figures::{
    markup::{Element, element},
    page,
};

const TITLE: &str = "The paper's figures, measured";

/// Writes `index.html` with all figures: self-contained, each with the paper's claims and the
/// verdicts.
///
/// # Errors
/// Returns an error if a CSV file is missing or the directory cannot be written.
pub fn write_index(directory: &Path) -> Result<(), String> {
    let mut main =
        element("main")
            .with(element("h1").text(TITLE))
            .with(element("p").class("lead").text(
            "Below each drawing: each claim of the paper about it, whether the measured numbers \
             support the claim, and the numbers. Learners are compared only within a preset of \
             the trainer: tuned, or the paper's Table I. Drawings and verdicts are made from the \
             CSV files in the directory of this page.",
        ));
    for experiment in Experiment::ALL {
        let drawing = experiment.draw(directory)?.to_element();
        let claims = experiment.claims(directory)?.into_iter();
        main.push(
            element("section")
                .with(element("h2").text(experiment.title()))
                .with(element("figure").with(element("div").class("scroll").with(drawing)))
                .with(element("dl").with_all(claims.flat_map(entries))),
        );
    }
    let generator = format!("host-sim {}", env!("CARGO_PKG_VERSION"));
    let page = page::page(TITLE.into(), generator, main);
    table::write_text(&directory.join("index.html"), &page)
}

/// Returns a claim with its verdict, and the measured numbers.
fn entries(claim: Claim) -> [Element; 2] {
    [
        element("dt")
            .with(element("b").text(claim.verdict.to_string()))
            .text(format!(" {}", claim.claimed)),
        element("dd").text(format!("{} {}", claim.measured, claim.reason)),
    ]
}
