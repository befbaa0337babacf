//! Lines, marks and text on one of the two kinds of paper.

use plotters::coord::Shift;
use plotters::element::{Circle, PathElement, Rectangle, Text};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{FontStyle, register_font};

use crate::error::{Error, Result};

/// The only family; its font comes with the program, so that no machine must have one.
const FAMILY: &str = "sans-serif";

/// Where a text begins, is in the middle, or ends.
#[derive(Clone, Copy)]
pub enum Anchor {
    Left,
    Middle,
    Right,
}

/// Paper in units of `scale` pixels, from the upper left corner.
pub struct Canvas<'a, P: DrawingBackend> {
    area: &'a DrawingArea<P, Shift>,
    scale: f64,
}

/// Makes the font known. Without it no text has a size.
pub fn know_font() -> Result<()> {
    register_font(FAMILY, FontStyle::Normal, dejavu::sans::regular())
        .map_err(|_| Error::Invalid("the font of the pictures cannot be read".into()))
}

fn told<E: std::fmt::Debug>(error: E) -> Error {
    Error::Invalid(format!("the picture cannot be drawn: {error:?}"))
}

fn rgb([r, g, b]: [u8; 3]) -> RGBColor {
    RGBColor(r, g, b)
}

impl<'a, P: DrawingBackend> Canvas<'a, P> {
    pub fn new(area: &'a DrawingArea<P, Shift>, scale: f64) -> Result<Self> {
        area.fill(&WHITE).map_err(told)?;
        Ok(Canvas { area, scale })
    }

    fn pixel(&self, (x, y): (f64, f64)) -> (i32, i32) {
        let round = |v: f64| (v * self.scale).round() as i32;
        (round(x), round(y))
    }

    pub fn line(&self, points: &[(f64, f64)], colour: [u8; 3], width: f64) -> Result<()> {
        let points: Vec<(i32, i32)> = points.iter().map(|&p| self.pixel(p)).collect();
        let width = (width * self.scale).round().max(1.0) as u32;
        let line = PathElement::new(points, rgb(colour).stroke_width(width));
        self.area.draw(&line).map_err(told)
    }

    /// The same in dashes.
    pub fn dashes(&self, points: &[(f64, f64)], colour: [u8; 3], width: f64) -> Result<()> {
        const DASH: f64 = 5.0;
        let mut travelled = 0.0;
        for pair in points.windows(2) {
            let ((x, y), (u, v)) = (pair[0], pair[1]);
            let length = (u - x).hypot(v - y);
            let at = |s: f64| (x + (u - x) * s / length, y + (v - y) * s / length);
            let mut s = 0.0;
            while s < length {
                let phase = travelled % (2.0 * DASH);
                let step = (DASH - phase % DASH).min(length - s).max(1e-3);
                if phase < DASH {
                    self.line(&[at(s), at(s + step)], colour, width)?;
                }
                s += step;
                travelled += step;
            }
        }
        Ok(())
    }

    pub fn dot(&self, at: (f64, f64), radius: f64, colour: [u8; 3]) -> Result<()> {
        let radius = (radius * self.scale).round() as i32;
        let dot = Circle::new(self.pixel(at), radius, rgb(colour).filled());
        self.area.draw(&dot).map_err(told)
    }

    pub fn ring(&self, at: (f64, f64), radius: f64, colour: [u8; 3]) -> Result<()> {
        let width = (1.8 * self.scale).round() as u32;
        let radius = (radius * self.scale).round() as i32;
        let ring = Circle::new(self.pixel(at), radius, rgb(colour).stroke_width(width));
        self.area.draw(&ring).map_err(told)
    }

    /// A square with a white middle.
    pub fn square(&self, (x, y): (f64, f64), radius: f64, colour: [u8; 3]) -> Result<()> {
        for (r, style) in [(radius, rgb(colour)), (radius - 1.5, WHITE)] {
            let corners = [self.pixel((x - r, y - r)), self.pixel((x + r, y + r))];
            self.area
                .draw(&Rectangle::new(corners, style.filled()))
                .map_err(told)?;
        }
        Ok(())
    }

    /// Text whose small letters are in the middle at the height of `at`.
    pub fn text(
        &self,
        text: &str,
        at: (f64, f64),
        size: f64,
        colour: [u8; 3],
        anchor: Anchor,
    ) -> Result<()> {
        let horizontal = match anchor {
            Anchor::Left => HPos::Left,
            Anchor::Middle => HPos::Center,
            Anchor::Right => HPos::Right,
        };
        let style = (FAMILY, size * self.scale)
            .into_font()
            .color(&rgb(colour))
            .pos(Pos::new(horizontal, VPos::Center));
        let text = Text::new(text.to_owned(), self.pixel((at.0, at.1 + 1.5)), style);
        self.area.draw(&text).map_err(told)
    }

    pub fn present(&self) -> Result<()> {
        self.area.present().map_err(told)
    }
}
