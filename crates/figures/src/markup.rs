//! SVG and HTML as a tree of elements: well-formed by construction, text always escaped.
//!
//! Every element is closed by a tag of its own (void HTML elements by `/>`), so a page is
//! well-formed XML as well, and a test can hand it to an XML parser.

use std::{
    borrow::Cow,
    fmt::{self, Display, Write},
};

/// HTML elements that have no content and no closing tag.
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
    /// Style sheets and scripts of this crate, which HTML wants unescaped.
    Verbatim(Cow<'static, str>),
}

/// An empty element.
pub fn element(name: &'static str) -> Element {
    Element {
        name,
        attributes: Vec::new(),
        content: Vec::new(),
    }
}

impl Element {
    /// With an attribute.
    pub fn set(mut self, name: &'static str, value: impl Into<Cow<'static, str>>) -> Self {
        self.attributes.push((name, value.into()));
        self
    }

    /// With a class: how it looks is written in the style sheet.
    pub fn class(self, class: &'static str) -> Self {
        self.set("class", class)
    }

    /// With a length or coordinate, in the drawing's unit, to a hundredth.
    pub fn at(self, name: &'static str, value: f64) -> Self {
        self.set(name, Coordinate(value).to_string())
    }

    /// With text inside.
    pub fn text(mut self, text: impl Into<Cow<'static, str>>) -> Self {
        self.content.push(Node::Text(text.into()));
        self
    }

    /// With a style sheet, a script or a drawing of ours inside, which is written as it is: a style
    /// sheet or script must not hold `<` or `&`.
    pub fn verbatim(mut self, text: impl Into<Cow<'static, str>>) -> Self {
        self.content.push(Node::Verbatim(text.into()));
        self
    }

    /// With another element inside.
    pub fn with(mut self, child: Element) -> Self {
        self.content.push(Node::Element(child));
        self
    }

    /// With other elements inside.
    pub fn with_all(mut self, children: impl IntoIterator<Item = Element>) -> Self {
        self.content.extend(children.into_iter().map(Node::Element));
        self
    }

    /// Adds an element inside.
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
        // A line per drawn thing keeps the files diffable.
        match self.name {
            "span" | "tspan" | "sub" | "title" => Ok(()),
            _ => f.write_char('\n'),
        }
    }
}

/// Text as the content of an element or an attribute. Control characters, which XML cannot
/// carry at all, become the replacement character.
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

/// A coordinate to a hundredth without trailing zeros; what is not finite is drawn at 0.
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

/// The `d` of a path, a move or line at a time.
#[derive(Clone, Debug, Default)]
pub struct PathData(String);

impl PathData {
    /// Lifts the pen and goes to a point.
    pub fn move_to(&mut self, x: f64, y: f64) {
        self.command('M', x, y);
    }

    /// Draws to a point.
    pub fn line_to(&mut self, x: f64, y: f64) {
        self.command('L', x, y);
    }

    fn command(&mut self, letter: char, x: f64, y: f64) {
        // Writing to a string cannot fail.
        let _ = write!(self.0, "{letter}{} {}", Coordinate(x), Coordinate(y));
    }

    /// A line through points.
    pub fn through(points: impl IntoIterator<Item = [f64; 2]>) -> Self {
        let mut data = Self::default();
        for (index, [x, y]) in points.into_iter().enumerate() {
            data.command(if index == 0 { 'M' } else { 'L' }, x, y);
        }
        data
    }

    /// As an element, to be filled or stroked by its class.
    pub fn path(self, class: &'static str) -> Element {
        element("path").class(class).set("d", self.0)
    }
}

/// A straight line.
pub fn line(class: &'static str, [x1, y1]: [f64; 2], [x2, y2]: [f64; 2]) -> Element {
    element("line")
        .class(class)
        .at("x1", x1)
        .at("y1", y1)
        .at("x2", x2)
        .at("y2", y2)
}

/// A rectangle; negative extents count as 0.
pub fn rectangle(class: &'static str, [x, y]: [f64; 2], [width, height]: [f64; 2]) -> Element {
    element("rect")
        .class(class)
        .at("x", x)
        .at("y", y)
        .at("width", width.max(0.0))
        .at("height", height.max(0.0))
}

/// A circle.
pub fn circle(class: &'static str, [x, y]: [f64; 2], radius: f64) -> Element {
    element("circle")
        .class(class)
        .at("cx", x)
        .at("cy", y)
        .at("r", radius)
}

/// Words at a place; how they are aligned is up to the class.
pub fn label(class: &'static str, [x, y]: [f64; 2], text: impl Into<Cow<'static, str>>) -> Element {
    element("text")
        .class(class)
        .at("x", x)
        .at("y", y)
        .text(text)
}
