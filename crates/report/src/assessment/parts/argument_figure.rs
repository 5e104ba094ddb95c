//! The goal structure as a figure: an outline from the top goal down, evidence beside each claim.

use maud::{Markup, html};

use super::{Argument, Element, ElementKind};
use crate::draw::{Anchor, Frame, Ink, SMALL, Stroke, Svg, straight, words, wrapped};

const WIDTH: f64 = 900.0;
const LINE: f64 = 14.0;
const PAD: f64 = 8.0;
/// Between one box and the next.
const GAP: f64 = 10.0;
const INDENT: f64 = 30.0;
/// Width of the cross through what is defeated.
const CROSS: f64 = 26.0;
/// Where evidence stands, and how wide it is.
const EVIDENCE_LEFT: f64 = 500.0;
const EVIDENCE_WIDTH: f64 = 330.0;

/// An element with its place.
struct Placed<'a> {
    element: &'a Element,
    frame: Frame,
    lines: Vec<String>,
}

impl<'a> Placed<'a> {
    fn new(element: &'a Element, left: f64, top: f64, width: f64) -> Self {
        let text = format!("{}  {}", element.id, element.text);
        let lines = wrapped(
            &text,
            SMALL,
            width - 2.0 * (PAD + slant(element.kind)) - if element.defeated { CROSS } else { 0.0 },
        );
        let height = LINE * lines.len() as f64 + 2.0 * PAD - 2.0;
        Self { element, frame: Frame { left, top, width, height }, lines }
    }
}

/// How far the ends of a shape lean in.
fn slant(kind: ElementKind) -> f64 {
    match kind {
        ElementKind::Goal => 0.0,
        ElementKind::Strategy | ElementKind::Context => 8.0,
        ElementKind::Solution | ElementKind::Assumption => 12.0,
    }
}

pub(super) fn draw(argument: &Argument) -> Svg {
    let mut figure = Figure { argument, placed: Vec::new(), links: Vec::new(), bottom: 4.0 };
    if let Some(top) = argument.elements.first() {
        figure.place(top, 0);
    }
    let content = html! {
        @for link in &figure.links { (link) }
        @for placed in &figure.placed { (shape(placed)) }
    };
    let description =
        "Goals as boxes, strategies as parallelograms, solutions as rounded boxes; crossed goals are defeated.";
    Svg::new("argument", (WIDTH, figure.bottom + 4.0), "Goal structure", description, content)
}

struct Figure<'a> {
    argument: &'a Argument,
    placed: Vec<Placed<'a>>,
    links: Vec<Markup>,
    bottom: f64,
}

impl<'a> Figure<'a> {
    /// Places an element and everything below it; returns where links to it end.
    fn place(&mut self, element: &'a Element, depth: usize) -> f64 {
        let left = 4.0 + INDENT * depth as f64;
        let top = self.bottom + GAP;
        let argument = self.argument;
        let below: Vec<_> = element.supported_by.iter().filter_map(|id| argument.find(id)).collect();
        let (evidence, parts): (Vec<_>, Vec<_>) = below.into_iter().partition(|e| e.kind == ElementKind::Solution);
        let contexts = element.in_context_of.iter().filter_map(|id| argument.find(id));
        let challenges = argument.challenges_to(&element.id);
        let beside: Vec<&Element> = evidence.into_iter().chain(contexts).chain(challenges).collect();
        let own = Placed::new(element, left, top, EVIDENCE_LEFT - 40.0 - left);
        let (own_frame, mut right_bottom) = (own.frame, top);
        let middle = own_frame.top + own_frame.height / 2.0;
        self.placed.push(own);
        for next in beside {
            let placed = Placed::new(next, EVIDENCE_LEFT, right_bottom, EVIDENCE_WIDTH);
            let frame = placed.frame;
            let end = (frame.left, (frame.top + frame.height / 2.0).min(own_frame.bottom().max(frame.top + 6.0)));
            let start = (own_frame.right(), middle.clamp(own_frame.top, own_frame.bottom()));
            let is_challenge = next.challenges.is_some();
            let dash = if is_challenge || next.kind != ElementKind::Solution { "4 3" } else { "" };
            let ink = if is_challenge { Ink::Alert } else { Ink::Axis };
            self.links.push(straight(start, end, Stroke { dash, ..Stroke::solid(ink, 1.2) }));
            right_bottom = frame.bottom() + GAP;
            self.placed.push(placed);
            if is_challenge {
                // Its evidence says what it says: the identifier is enough.
                let (x, y) = (frame.right() + 22.0, frame.top + frame.height / 2.0);
                self.links.push(straight((frame.right(), y), (x - 14.0, y), Stroke::solid(Ink::Axis, 1.2)));
                let id = next.supported_by.first().map_or("", String::as_str);
                self.links.push(html! {
                    ellipse cx=(px(x + 4.0)) cy=(px(y)) rx="18" ry="10" fill=(Ink::Paper.hex()) stroke=(Ink::Axis.hex()) {}
                    (words((x + 4.0, y + 4.0), Anchor::Middle, id, SMALL, Ink::Text, false))
                });
            }
        }
        self.bottom = own_frame.bottom().max(right_bottom - GAP);
        for part in parts {
            let x = left + INDENT / 2.0;
            let y = self.place(part, depth + 1);
            self.links.push(straight((x, own_frame.bottom()), (x, y), Stroke::solid(Ink::Axis, 1.2)));
            self.links.push(straight((x, y), (left + INDENT, y), Stroke::solid(Ink::Axis, 1.2)));
        }
        middle
    }
}

fn shape(placed: &Placed<'_>) -> Markup {
    let Placed { element, frame, lines } = placed;
    let (left, right, top, bottom) = (frame.left, frame.right(), frame.top, frame.bottom());
    let ink = if element.challenges.is_some() { Ink::Alert } else { Ink::Text };
    let lean = slant(element.kind);
    html! {
        @match element.kind {
            ElementKind::Strategy => {
                polygon points={ (px(left + lean)) "," (px(top)) " " (px(right)) "," (px(top)) " " (px(right - lean)) "," (px(bottom))
                    " " (px(left)) "," (px(bottom)) } fill=(Ink::Paper.hex()) stroke=(ink.hex()) {}
            }
            kind => {
                @let round = match kind { ElementKind::Goal => 0.0, ElementKind::Context => 8.0, _ => frame.height / 2.0 };
                rect x=(px(left)) y=(px(top)) width=(px(frame.width)) height=(px(frame.height)) rx=(px(round.min(16.0)))
                    fill=(Ink::Paper.hex()) stroke=(ink.hex()) {}
            }
        }
        @if element.defeated {
            // At the end, where it crosses out no word.
            @let from = right - CROSS;
            (straight((from, top), (right, bottom), Stroke::solid(Ink::Alert, 1.6)))
            (straight((from, bottom), (right, top), Stroke::solid(Ink::Alert, 1.6)))
        }
        @if element.undeveloped {
            @let x = right + 12.0;
            @let y = f64::midpoint(top, bottom);
            polygon points={ (px(x - 8.0)) "," (px(y)) " " (px(x)) "," (px(y - 8.0)) " " (px(x + 8.0)) "," (px(y)) " " (px(x)) "," (px(y + 8.0)) }
                fill=(Ink::Paper.hex()) stroke=(ink.hex()) {}
        }
        @for (index, line) in lines.iter().enumerate() {
            @let base = top + PAD + LINE * (index as f64 + 0.75);
            (words((left + PAD + lean, base), Anchor::Start, line, SMALL, ink, false))
        }
    }
}

fn px(value: f64) -> String {
    format!("{value:.1}")
}
