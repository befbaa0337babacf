//! A picture of several panels, as SVG and as PNG.

use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use plotters::prelude::{BitMapBackend, DrawingBackend, IntoDrawingArea, SVGBackend};

use super::canvas::{Anchor, Canvas, know_font};
use super::panel::{LARGE, Look, Panel, Ranges, SMALL};
use crate::error::{Error, Result};

const TITLE: [u8; 3] = [20, 20, 20];
const WORDS: [u8; 3] = [90, 90, 90];
/// Pixels of the PNG for one unit.
const PNG_SCALE: u32 = 2;
const EDGE: f64 = 14.0;
/// Height of a line of the legend or the text below, and the mean width of a letter.
const LINE: f64 = 20.0;
const LETTER: f64 = 6.4;

pub struct Picture {
    /// That of the file, without its ending.
    pub name: &'static str,
    pub title: String,
    /// What is shown, and where it was measured.
    pub about: String,
    pub machine: String,
    pub columns: usize,
    /// Width and height of each panel.
    pub panel: (u32, u32),
    /// Row by row.
    pub panels: Vec<Panel>,
    pub legend: Vec<(String, Look)>,
}

impl Picture {
    pub fn svg(&self) -> Result<String> {
        know_font()?;
        let mut text = String::new();
        let size = self.size();
        let area = SVGBackend::with_string(&mut text, size).into_drawing_area();
        self.draw(&Canvas::new(&area, 1.0)?)?;
        drop(area);
        Ok(text)
    }

    pub fn png(&self) -> Result<Vec<u8>> {
        know_font()?;
        let (width, height) = self.size();
        let (width, height) = (PNG_SCALE * width, PNG_SCALE * height);
        let mut pixels = vec![255; 3 * width as usize * height as usize];
        let backend = BitMapBackend::with_buffer(&mut pixels, (width, height));
        let area = backend.into_drawing_area();
        self.draw(&Canvas::new(&area, f64::from(PNG_SCALE))?)?;
        drop(area);
        let mut bytes = Vec::new();
        PngEncoder::new(&mut bytes)
            .write_image(&pixels, width, height, ExtendedColorType::Rgb8)
            .map_err(|e| Error::Invalid(format!("the picture cannot be encoded as PNG: {e}")))?;
        Ok(bytes)
    }

    fn width(&self) -> f64 {
        let panels = self.columns as f64 * f64::from(self.panel.0);
        panels.max(600.0) + 2.0 * EDGE
    }

    /// Lines of the legend: its entries, with their places.
    fn legend_lines(&self) -> Vec<Vec<(f64, usize)>> {
        let mut lines = vec![Vec::new()];
        let mut x = EDGE;
        for (k, (name, _)) in self.legend.iter().enumerate() {
            let width = 62.0 + LETTER * name.chars().count() as f64;
            if x + width > self.width() - EDGE && x > EDGE {
                lines.push(Vec::new());
                x = EDGE;
            }
            lines.last_mut().expect("there is one").push((x, k));
            x += width;
        }
        lines
    }

    /// The text below in lines that fit.
    fn words(&self) -> Vec<String> {
        let most = ((self.width() - 2.0 * EDGE) / LETTER) as usize;
        let mut lines = Vec::new();
        for text in [&self.about, &self.machine] {
            let mut line = String::new();
            for word in text.split_whitespace() {
                if !line.is_empty() && line.len() + word.len() + 1 > most {
                    lines.push(std::mem::take(&mut line));
                }
                if !line.is_empty() {
                    line.push(' ');
                }
                line.push_str(word);
            }
            lines.push(line);
        }
        lines
    }

    /// Height of what is above the panels.
    fn head(&self) -> f64 {
        44.0 + LINE * self.legend_lines().iter().filter(|l| !l.is_empty()).count() as f64
    }

    fn size(&self) -> (u32, u32) {
        let rows = self.panels.len().div_ceil(self.columns) as f64;
        let words = LINE * self.words().len() as f64;
        let height = self.head() + rows * f64::from(self.panel.1) + words + EDGE;
        (self.width() as u32, height as u32)
    }

    fn draw<P: DrawingBackend>(&self, canvas: &Canvas<P>) -> Result<()> {
        canvas.text(&self.title, (EDGE, 22.0), LARGE + 5.0, TITLE, Anchor::Left)?;
        for (l, line) in self.legend_lines().iter().enumerate() {
            let y = 50.0 + LINE * l as f64;
            for &(x, k) in line {
                let (name, look) = &self.legend[k];
                look.sample(canvas, (x, x + 30.0), y)?;
                canvas.text(name, (x + 40.0, y), SMALL, TITLE, Anchor::Left)?;
            }
        }
        let (width, height) = (f64::from(self.panel.0), f64::from(self.panel.1));
        let mut y = self.head();
        for row in self.panels.chunks(self.columns) {
            let ranges = Ranges::of(row);
            for (k, panel) in row.iter().enumerate() {
                let corner = (EDGE + k as f64 * width, y);
                panel.draw(canvas, corner, (width, height), ranges)?;
            }
            y += height;
        }
        for (k, line) in self.words().iter().enumerate() {
            let at = (EDGE, y + 12.0 + LINE * k as f64);
            canvas.text(line, at, SMALL, WORDS, Anchor::Left)?;
        }
        canvas.present()
    }
}
