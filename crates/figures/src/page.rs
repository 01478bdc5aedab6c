//! Whole HTML pages: complete in one file, in both colour schemes, and in the light one on paper.

use crate::{
    markup::{Element, element},
    theme,
};

/// Returns a page with the style sheet of this crate. `generator` is the program and its version.
pub fn page(title: String, generator: String, main: Element) -> String {
    let meta = |name: &'static str, content: String| {
        element("meta").set("name", name).set("content", content)
    };
    let head = element("head")
        .with(element("meta").set("charset", "utf-8"))
        .with(meta(
            "viewport",
            "width=device-width, initial-scale=1".into(),
        ))
        .with(meta("generator", generator))
        .with(element("title").text(title))
        .with(theme::page_style());
    let body = element("body").with(main);
    let page = element("html").set("lang", "en").with(head).with(body);
    format!("<!DOCTYPE html>\n{page}")
}
