//! What columns without names mean.
//!
//! The first three are the place. Of the others, the first three whose squares add up to one are
//! the normal, and the first three that are whole numbers up to 255, or fractions from 0 to 1, are
//! the colour; a single one before or between them is the intensity. Where a value before three
//! colours could be one itself, as the intensity of PTS files is, it is no colour, unless the last
//! of the four is an alpha: always 255 or 1.

/// A darkest brightest value of a colour: smaller whole numbers are classes or counts.
const BRIGHT: f64 = 31.0;
/// How far the length of a normal may be from one, when it is written with few digits.
const LENGTH: f64 = 0.05;

/// Values of some lines.
pub struct Sample {
    columns: usize,
    /// Line after line.
    values: Vec<f64>,
}

impl Sample {
    pub fn new(columns: usize, lines: impl Iterator<Item = Vec<f64>>) -> Self {
        Sample {
            columns,
            values: lines.flatten().collect(),
        }
    }

    /// Three columns, line by line.
    fn three(&self, at: usize) -> impl Iterator<Item = [f64; 3]> {
        let lines = self.values.chunks_exact(self.columns);
        lines.map(move |line| [line[at], line[at + 1], line[at + 2]])
    }

    fn one(&self, at: usize) -> impl Iterator<Item = f64> {
        self.values
            .chunks_exact(self.columns)
            .map(move |line| line[at])
    }

    fn are_normals(&self, at: usize) -> bool {
        let mut some = false;
        at + 3 <= self.columns
            && self.three(at).all(|v| {
                let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
                some |= length > 0.0;
                length == 0.0 || (length - 1.0).abs() < LENGTH || length.is_nan()
            })
            && some
    }

    fn are_colours(&self, at: usize) -> bool {
        if at + 3 > self.columns {
            return false;
        }
        let all = |good: &dyn Fn(f64) -> bool| self.three(at).flatten().all(good);
        let largest = self.three(at).flatten().fold(0.0, f64::max);
        let whole = all(&|x| x.fract() == 0.0);
        if whole {
            largest > BRIGHT && all(&|x| (0.0..=255.0).contains(&x))
        } else {
            all(&|x| (0.0..=1.0).contains(&x))
        }
    }

    fn is_alpha(&self, at: usize) -> bool {
        at < self.columns
            && [1.0, 255.0]
                .iter()
                .any(|&full| self.one(at).all(|x| x == full))
    }
}

/// Names of the columns, as PLY files have them; empty for those that mean nothing here.
pub fn names(sample: &Sample) -> Vec<String> {
    let mut names = vec!["x", "y", "z"];
    let (mut normals, mut colours, mut intensity) = (false, false, false);
    while names.len() < sample.columns {
        let at = names.len();
        let is_colour = |at: usize| !colours && sample.are_colours(at);
        if !normals && sample.are_normals(at) {
            normals = true;
            names.extend(["nx", "ny", "nz"]);
        } else if is_colour(at) && (!is_colour(at + 1) || sample.is_alpha(at + 3)) {
            colours = true;
            names.extend(["red", "green", "blue"]);
        } else if sample.is_alpha(at) && names.last() == Some(&"blue") {
            names.push("alpha");
        } else if !intensity && sample.columns > 3 {
            intensity = true;
            names.push("intensity");
        } else {
            names.push("");
        }
    }
    names.into_iter().map(str::to_owned).collect()
}
