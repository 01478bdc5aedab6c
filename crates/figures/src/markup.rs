//! SVG and HTML as a tree of elements: well-formed by construction, with text always escaped.
//!
//! Every element has a closing tag (void HTML elements end in `/>`), so a page is also well-formed
//! XML, and tests can parse it with an XML parser.

use std::{
    borrow::Cow,
    fmt::{self, Display, Write},
};

/// The HTML elements that have no content and no closing tag.
const VOID: [&str; 3] = ["br", "meta", "col"];

/// An element with its attributes and content.
#[derive(Clone, Debug)]
pub struct Element {
    name: &'static str,
    attributes: Vec<(&'static str, Cow<'static, str>)>,
    content: Vec<Node>,
}

#[derive(Clone, Debug)]
enum Node {
    Element(Element),
    Text(Cow<'static, str>),
    /// Style sheets and scripts of this crate, which must not be escaped in HTML.
    Verbatim(Cow<'static, str>),
}

/// Creates an empty element.
pub fn element(name: &'static str) -> Element {
    Element {
        name,
        attributes: Vec::new(),
        content: Vec::new(),
    }
}

impl Element {
    /// Adds an attribute.
    pub fn set(mut self, name: &'static str, value: impl Into<Cow<'static, str>>) -> Self {
        self.attributes.push((name, value.into()));
        self
    }

    /// Sets the class. The style sheet defines its appearance.
    pub fn class(self, class: &'static str) -> Self {
        self.set("class", class)
    }

    /// Adds a length or coordinate as an attribute, in the drawing's unit, rounded to a hundredth.
    pub fn at(self, name: &'static str, value: f64) -> Self {
        self.set(name, Coordinate(value).to_string())
    }

    /// Adds text as content.
    pub fn text(mut self, text: impl Into<Cow<'static, str>>) -> Self {
        self.content.push(Node::Text(text.into()));
        self
    }

    /// Adds a style sheet or a script of this project as content, without escaping it. It must not
    /// contain `<` or `&`.
    pub fn verbatim(mut self, text: impl Into<Cow<'static, str>>) -> Self {
        self.content.push(Node::Verbatim(text.into()));
        self
    }

    /// Adds another element as content.
    pub fn with(mut self, child: Element) -> Self {
        self.content.push(Node::Element(child));
        self
    }

    /// Adds other elements as content.
    pub fn with_all(mut self, children: impl IntoIterator<Item = Element>) -> Self {
        self.content.extend(children.into_iter().map(Node::Element));
        self
    }

    /// Adds another element as content, in place.
    pub fn push(&mut self, child: Element) {
        self.content.push(Node::Element(child));
    }
}

impl Display for Element {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "<{}", self.name)?;
        for (name, value) in &self.attributes {
            write!(f, " {name}=\"{}\"", Escaped(value))?;
        }
        if VOID.contains(&self.name) {
            return f.write_str("/>");
        }
        f.write_char('>')?;
        for node in &self.content {
            match node {
                Node::Element(child) => child.fmt(f)?,
                Node::Text(text) => Escaped(text).fmt(f)?,
                Node::Verbatim(text) => f.write_str(text)?,
            }
        }
        write!(f, "</{}>", self.name)?;
        // One line per drawn element keeps the differences between files readable.
        match self.name {
            "span" | "tspan" | "sub" | "title" => Ok(()),
            _ => f.write_char('\n'),
        }
    }
}

/// Text as the content of an element or an attribute. Control characters, which XML cannot
/// represent, are written as the replacement character.
struct Escaped<'a>(&'a str);

impl Display for Escaped<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for character in self.0.chars() {
            match character {
                '&' => f.write_str("&amp;")?,
                '<' => f.write_str("&lt;")?,
                '>' => f.write_str("&gt;")?,
                '"' => f.write_str("&quot;")?,
                '\'' => f.write_str("&#39;")?,
                '\t' | '\n' => f.write_char(character)?,
                '\u{fffe}' | '\u{ffff}' => f.write_char(char::REPLACEMENT_CHARACTER)?,
                _ if character.is_control() => f.write_char(char::REPLACEMENT_CHARACTER)?,
                _ => f.write_char(character)?,
            }
        }
        Ok(())
    }
}

/// A coordinate, rounded to a hundredth, without trailing zeros. Numbers that are not finite are
/// drawn at 0.
struct Coordinate(f64);

impl Display for Coordinate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let hundredths = (self.0 * 100.0).round();
        // Adding 0 turns -0 into 0.
        let value = if hundredths.is_finite() {
            hundredths / 100.0 + 0.0
        } else {
            0.0
        };
        value.fmt(f)
    }
}

/// The `d` attribute of a path, built from moves, lines and circles.
#[derive(Clone, Debug, Default)]
pub struct PathData(String);

impl PathData {
    /// Moves to a point without drawing.
    pub fn move_to(&mut self, x: f64, y: f64) {
        self.command('M', x, y);
    }

    /// Draws a line to a point.
    pub fn line_to(&mut self, x: f64, y: f64) {
        self.command('L', x, y);
    }

    /// Draws a line back to the last point that was moved to.
    pub fn close(&mut self) {
        self.0.push('Z');
    }

    /// Draws a circle.
    pub fn circle(&mut self, [x, y]: [f64; 2], radius: f64) {
        self.move_to(x - radius, y);
        let [r, d] = [Coordinate(radius), Coordinate(2.0 * radius)];
        // Writing to a string cannot fail.
        let _ = write!(self.0, "a{r} {r} 0 1 0 {d} 0a{r} {r} 0 1 0 -{d} 0Z");
    }

    fn command(&mut self, letter: char, x: f64, y: f64) {
        // Writing to a string cannot fail.
        let _ = write!(self.0, "{letter}{} {}", Coordinate(x), Coordinate(y));
    }

    /// Returns a line through these points.
    pub fn through(points: impl IntoIterator<Item = [f64; 2]>) -> Self {
        let mut data = Self::default();
        for (index, [x, y]) in points.into_iter().enumerate() {
            data.command(if index == 0 { 'M' } else { 'L' }, x, y);
        }
        data
    }

    /// Returns the path as an element, which its class fills or strokes.
    pub fn path(self, class: impl Into<Cow<'static, str>>) -> Element {
        element("path").set("class", class).set("d", self.0)
    }
}

/// Creates a straight line.
pub fn line(class: &'static str, [x1, y1]: [f64; 2], [x2, y2]: [f64; 2]) -> Element {
    element("line")
        .class(class)
        .at("x1", x1)
        .at("y1", y1)
        .at("x2", x2)
        .at("y2", y2)
}

/// Creates a rectangle. Negative extents count as 0.
pub fn rectangle(class: &'static str, [x, y]: [f64; 2], [width, height]: [f64; 2]) -> Element {
    element("rect")
        .class(class)
        .at("x", x)
        .at("y", y)
        .at("width", width.max(0.0))
        .at("height", height.max(0.0))
}

/// Creates a circle.
pub fn circle(class: &'static str, [x, y]: [f64; 2], radius: f64) -> Element {
    element("circle")
        .class(class)
        .at("cx", x)
        .at("cy", y)
        .at("r", radius)
}

/// Creates a text at a position. The class defines how it is aligned.
pub fn label(class: &'static str, [x, y]: [f64; 2], text: impl Into<Cow<'static, str>>) -> Element {
    element("text")
        .class(class)
        .at("x", x)
        .at("y", y)
        .text(text)
}
