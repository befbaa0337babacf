//! One panel: axes, curves, or rows of two marks.

use plotters::prelude::DrawingBackend;

use super::canvas::{Anchor, Canvas};
use crate::error::Result;

const INK: [u8; 3] = [40, 40, 40];
const LIGHT: [u8; 3] = [225, 225, 225];
const FRAME: [u8; 3] = [120, 120, 120];
pub const SMALL: f64 = 13.0;
pub const LARGE: f64 = 15.0;
/// Room around the plot: left, top, right, bottom.
const MARGINS: [f64; 4] = [62.0, 52.0, 14.0, 42.0];
/// Of labels at the ends of curves, and of the names of rows and the words behind them.
const LABELS: f64 = 120.0;
const NAMES: f64 = 110.0;
const WORDS: f64 = 36.0;

#[derive(Clone, Copy, PartialEq)]
pub enum Mark {
    /// As wide as the line.
    End,
    Dot,
    Square,
    Ring,
}

#[derive(Clone, Copy)]
pub struct Look {
    pub colour: [u8; 3],
    pub dashed: bool,
    pub width: f64,
    pub mark: Mark,
}

pub struct Curve {
    pub look: Look,
    pub points: Vec<(f64, f64)>,
    /// At the curve's right end.
    pub label: Option<String>,
}

/// What the numbers of an axis are.
#[derive(Clone, Copy, PartialEq)]
pub enum Unit {
    Seconds,
    Percent,
    Bytes,
    Count,
}

pub struct Axis {
    name: &'static str,
    unit: Unit,
    log: bool,
}

/// Two marks in a row, with a name before and a word behind.
pub type Row = (String, [(f64, Look); 2], String);

pub enum Drawn {
    Curves(Vec<Curve>),
    Rows(Vec<Row>),
}

pub struct Panel {
    pub title: String,
    pub x: Axis,
    pub y: Axis,
    pub drawn: Drawn,
}

impl Axis {
    pub fn log(name: &'static str, unit: Unit) -> Axis {
        let log = true;
        Axis { name, unit, log }
    }

    pub fn linear(name: &'static str, unit: Unit) -> Axis {
        let log = false;
        Axis { name, unit, log }
    }

    /// The range of some values with a margin, on the scale of the axis.
    fn range(&self, values: impl Iterator<Item = f64>) -> (f64, f64) {
        let values = values.map(|v| self.place(v)).filter(|v| v.is_finite());
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| {
            (l.min(v), h.max(v))
        });
        let margin = match (self.log, low < high) {
            _ if low > high => return (0.0, 1.0),
            (_, true) => 0.06 * (high - low),
            _ => 0.3,
        };
        (low - margin, high + margin)
    }

    fn place(&self, value: f64) -> f64 {
        if self.log { value.log10() } else { value }
    }

    /// Places and texts of the ticks within a range.
    fn ticks(&self, (low, high): (f64, f64)) -> Vec<(f64, String)> {
        let mut values = Vec::new();
        if self.log {
            let steps: &[f64] = match high - low {
                s if s > 2.5 => &[1.0],
                s if s > 1.3 => &[1.0, 3.0],
                _ => &[1.0, 2.0, 5.0],
            };
            for decade in low.floor() as i32..=high.ceil() as i32 {
                values.extend(steps.iter().map(|s| s * 10f64.powi(decade)));
            }
            // Of many decades every second or third.
            let every = ((high - low) / 6.0).ceil().max(1.0) as i32;
            values.retain(|v| (v.log10().floor() as i32).rem_euclid(every) == 0);
        } else {
            let step = ((high - low) / 8.0).ceil().max(1.0);
            values.extend(
                (0..)
                    .map(|k| f64::from(k) * step)
                    .take_while(|v| *v <= high),
            );
        }
        let within = |v: &f64| (low..=high).contains(&self.place(*v));
        values.retain(within);
        values.iter().map(|&v| (v, self.unit.text(v))).collect()
    }
}

impl Unit {
    fn text(self, value: f64) -> String {
        let scaled = |units: &[(f64, &str)]| {
            let fits = units.iter().find(|(size, _)| value >= 0.999 * size);
            let (size, unit) = fits.or(units.last()).copied().unwrap_or((1.0, ""));
            format!("{}{unit}", trimmed(value / size))
        };
        match self {
            Unit::Seconds => scaled(&[(1.0, " s"), (1e-3, " ms"), (1e-6, " µs")]),
            Unit::Percent => format!("{}%", trimmed(100.0 * value)),
            Unit::Bytes => scaled(&[(1e9, " GB"), (1e6, " MB"), (1e3, " kB")]),
            Unit::Count => scaled(&[(1e6, "M"), (1e3, "k"), (1.0, "")]),
        }
    }
}

/// Three digits at most, without zeros behind.
fn trimmed(value: f64) -> String {
    if value == 0.0 {
        return "0".into();
    }
    let digits = (2 - value.abs().log10().floor() as i32).max(0) as usize;
    let text = format!("{value:.digits$}");
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

/// What all panels of a row share, so that they can be compared.
#[derive(Clone, Copy)]
pub struct Ranges {
    x: (f64, f64),
    y: (f64, f64),
}

impl Ranges {
    pub fn of(panels: &[Panel]) -> Ranges {
        let values = |pick: fn(&(f64, f64)) -> f64| {
            panels.iter().flat_map(move |panel| -> Vec<f64> {
                match &panel.drawn {
                    Drawn::Curves(curves) => curves
                        .iter()
                        .flat_map(|c| c.points.iter().map(pick))
                        .collect(),
                    Drawn::Rows(rows) => rows
                        .iter()
                        .flat_map(|r| r.1.map(|(value, _)| value))
                        .collect(),
                }
            })
        };
        Ranges {
            x: panels[0].x.range(values(|p| p.0)),
            y: panels[0].y.range(values(|p| p.1)),
        }
    }
}

impl Panel {
    /// Draws the panel into a rectangle: its corner, width and height.
    pub fn draw<P: DrawingBackend>(
        &self,
        canvas: &Canvas<P>,
        (left, top): (f64, f64),
        (width, height): (f64, f64),
        ranges: Ranges,
    ) -> Result<()> {
        let rows = matches!(self.drawn, Drawn::Rows(_));
        let behind = match &self.drawn {
            Drawn::Rows(_) => WORDS,
            Drawn::Curves(curves) if curves.iter().any(|c| c.label.is_some()) => LABELS,
            Drawn::Curves(_) => 0.0,
        };
        let begin = left + if rows { NAMES } else { MARGINS[0] };
        let end = left + width - MARGINS[2] - behind;
        let (upper, lower) = (top + MARGINS[1], top + height - MARGINS[3]);
        let part = |(low, high): (f64, f64), v: f64| (v - low) / (high - low);
        let x = |v: f64| begin + (end - begin) * part(ranges.x, self.x.place(v));
        let y = |v: f64| lower - (lower - upper) * part(ranges.y, self.y.place(v));

        canvas.text(&self.title, (begin, top + 14.0), LARGE, INK, Anchor::Left)?;
        canvas.text(self.y.name, (begin, top + 36.0), SMALL, FRAME, Anchor::Left)?;
        canvas.text(
            self.x.name,
            (end, lower + 34.0),
            SMALL,
            FRAME,
            Anchor::Right,
        )?;
        for (value, text) in self.x.ticks(ranges.x) {
            canvas.line(&[(x(value), upper), (x(value), lower)], LIGHT, 1.0)?;
            canvas.text(&text, (x(value), lower + 14.0), SMALL, INK, Anchor::Middle)?;
        }
        if !rows {
            for (value, text) in self.y.ticks(ranges.y) {
                canvas.line(&[(begin, y(value)), (end, y(value))], LIGHT, 1.0)?;
                canvas.text(&text, (begin - 6.0, y(value)), SMALL, INK, Anchor::Right)?;
            }
        }
        let corners = [
            (begin, upper),
            (end, upper),
            (end, lower),
            (begin, lower),
            (begin, upper),
        ];
        canvas.line(&corners, FRAME, 1.0)?;
        match &self.drawn {
            Drawn::Curves(curves) => {
                for curve in curves {
                    let points: Vec<(f64, f64)> =
                        curve.points.iter().map(|&(u, v)| (x(u), y(v))).collect();
                    curve.look.draw(canvas, &points)?;
                }
                labels(canvas, curves, end + 8.0, (upper, lower), &y)
            }
            Drawn::Rows(rows) => {
                let step = (lower - upper) / rows.len().max(1) as f64;
                for (k, (name, marks, word)) in rows.iter().enumerate() {
                    let height = upper + (k as f64 + 0.5) * step;
                    canvas.text(name, (begin - 6.0, height), SMALL, INK, Anchor::Right)?;
                    canvas.text(word, (end + WORDS, height), SMALL, INK, Anchor::Right)?;
                    let ends = marks.map(|(value, _)| (x(value), height));
                    canvas.line(&ends, LIGHT, 3.0)?;
                    for ((_, look), at) in marks.iter().zip(ends) {
                        look.mark(canvas, at)?;
                    }
                }
                Ok(())
            }
        }
    }
}

/// The labels of curves at the height of their ends, moved apart where they would overlap.
fn labels<P: DrawingBackend>(
    canvas: &Canvas<P>,
    curves: &[Curve],
    left: f64,
    (upper, lower): (f64, f64),
    y: &dyn Fn(f64) -> f64,
) -> Result<()> {
    const APART: f64 = 15.0;
    let mut places: Vec<(f64, &str, [u8; 3])> = curves
        .iter()
        .filter_map(|c| Some((y(c.points.last()?.1), c.label.as_deref()?, c.look.colour)))
        .collect();
    places.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut next = upper;
    for place in &mut places {
        place.0 = place.0.max(next);
        next = place.0 + APART;
    }
    let mut most = lower;
    for place in places.iter_mut().rev() {
        place.0 = place.0.min(most);
        most = place.0 - APART;
    }
    for (height, text, colour) in places {
        canvas.text(text, (left, height), SMALL, colour, Anchor::Left)?;
    }
    Ok(())
}

impl Look {
    /// A sample of the line from one place to another.
    pub fn sample<P: DrawingBackend>(
        &self,
        canvas: &Canvas<P>,
        (left, right): (f64, f64),
        y: f64,
    ) -> Result<()> {
        match self.mark {
            Mark::Ring => self.mark(canvas, (0.5 * (left + right), y)),
            _ => self.draw(canvas, &[(left, y), (right, y)]),
        }
    }

    /// The line through some places, and the marks at them.
    pub fn draw<P: DrawingBackend>(&self, canvas: &Canvas<P>, at: &[(f64, f64)]) -> Result<()> {
        // Rings are drawn around what is chosen, not connected.
        if self.mark != Mark::Ring && at.len() > 1 {
            match self.dashed {
                false => canvas.line(at, self.colour, self.width)?,
                true => canvas.dashes(at, self.colour, self.width)?,
            }
        }
        at.iter().try_for_each(|&at| self.mark(canvas, at))
    }

    fn mark<P: DrawingBackend>(&self, canvas: &Canvas<P>, at: (f64, f64)) -> Result<()> {
        match self.mark {
            Mark::End => canvas.dot(at, 0.5 * self.width, self.colour),
            Mark::Dot => canvas.dot(at, 3.6, self.colour),
            Mark::Square => canvas.square(at, 3.6, self.colour),
            Mark::Ring => canvas.ring(at, 7.0, self.colour),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_their_units() {
        assert_eq!(Unit::Seconds.text(0.03), "30 ms");
        assert_eq!(Unit::Seconds.text(10.0), "10 s");
        assert_eq!(Unit::Seconds.text(2e-5), "20 µs");
        assert_eq!(Unit::Percent.text(3e-4), "0.03%");
        assert_eq!(Unit::Percent.text(1.0), "100%");
        assert_eq!(Unit::Percent.text(1e-9), "0.0000001%");
        assert_eq!(Unit::Count.text(2e3), "2k");
        assert_eq!(Unit::Count.text(0.0), "0");
        assert_eq!(Unit::Bytes.text(3e7), "30 MB");
    }

    #[test]
    fn ticks_lie_within_and_are_few() {
        for (low, high) in [
            (1e-9f64, 1.0f64),
            (0.001, 0.2),
            (0.5, 0.6),
            (1e-3, 1e4),
            (2.0, 2.0),
        ] {
            let axis = Axis::log("", Unit::Seconds);
            let range = axis.range([low, high].into_iter());
            let ticks = axis.ticks(range);
            let inside = |v: f64| (range.0..=range.1).contains(&v.log10());
            assert!(
                ticks.len() <= 8 && ticks.iter().all(|t| inside(t.0)),
                "{low} {high}"
            );
        }
        let orders = Axis::linear("", Unit::Count);
        let range = orders.range((0..=6).map(f64::from));
        assert_eq!(orders.ticks(range).len(), 7);
    }
}
