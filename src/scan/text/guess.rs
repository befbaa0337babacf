//! What columns without names mean, judged by what their values do in many rows.
//!
//! Three columns are the place: the first, or those behind a row and a column of a grid, which count up, or
//! behind a running number or a label; these are whole numbers without a decimal point, and the place has
//! some. Of the others, the first three whose squares add up to one are the normal, and the first three that
//! are whole numbers up to 255 or 65535, or fractions from 0 to 1, are the colour. Where four could be, an
//! intensity may come before the colour or a label behind it: of neighbours the channels of a colour are more
//! alike.

use std::collections::HashSet;

/// A darkest brightest value of a colour: smaller whole numbers are classes or counts.
const BRIGHT: f64 = 31.0;
/// How far the length of a normal may be from one, when it is written with few digits.
const LENGTH: f64 = 0.05;
/// Most labels.
const LABELS: usize = 64;
/// Where three columns and three others are so nearly alike, either could be the colour.
const DOUBT: f64 = 0.8;

/// Values of some lines.
#[derive(Default)]
pub struct Sample {
    pub columns: usize,
    /// Line after line.
    values: Vec<f64>,
    /// Columns of which a value has a decimal point.
    pointed: Vec<bool>,
    /// Lines that begin a run: those of a run follow one another in the file.
    begins: Vec<usize>,
}

/// What the columns mean, and what they could mean as well.
pub struct Guess {
    pub names: Vec<String>,
    pub other: Option<Vec<String>>,
}

impl Sample {
    pub fn new(columns: usize) -> Self {
        Sample {
            columns,
            pointed: vec![false; columns],
            ..Sample::default()
        }
    }

    /// Begins a run of lines.
    pub fn begin(&mut self) {
        self.begins.push(self.values.len() / self.columns);
    }

    /// Adds a line: its values, and which of them have a decimal point.
    pub fn push(&mut self, line: &[(f64, bool)]) {
        for (column, &(value, pointed)) in line.iter().enumerate() {
            self.values.push(value);
            self.pointed[column] |= pointed;
        }
    }

    fn lines(&self) -> impl DoubleEndedIterator<Item = &[f64]> {
        self.values.chunks_exact(self.columns)
    }

    fn one(&self, at: usize) -> impl Iterator<Item = f64> {
        self.lines().map(move |line| line[at])
    }

    /// Three columns, line by line.
    fn three(&self, at: usize) -> impl Iterator<Item = [f64; 3]> {
        self.lines()
            .map(move |line| [line[at], line[at + 1], line[at + 2]])
    }

    /// Lines that follow one another.
    fn pairs(&self) -> impl Iterator<Item = (&[f64], &[f64])> {
        let pairs = self.lines().zip(self.lines().skip(1)).enumerate();
        pairs
            .filter(|(i, _)| !self.begins.contains(&(i + 1)))
            .map(|(_, pair)| pair)
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
        let largest = |at: usize| self.one(at).fold(0.0, f64::max);
        let each = [0, 1, 2].map(|k| largest(at + k));
        let brightest = each.into_iter().fold(0.0, f64::max);
        if !all(&|x| x.fract() == 0.0) {
            return all(&|x| (0.0..=1.0).contains(&x));
        }
        let least = each.into_iter().fold(f64::INFINITY, f64::min);
        let are_alike = brightest <= 255.0 || least * 16.0 > brightest;
        brightest > BRIGHT && are_alike && all(&|x| (0.0..=65535.0).contains(&x))
    }

    fn is_alpha(&self, at: usize) -> bool {
        at < self.columns
            && [1.0, 255.0]
                .iter()
                .any(|&full| self.one(at).all(|x| x == full))
    }

    /// How far three channels are apart, on average.
    fn spread(&self, at: usize) -> f64 {
        let spread = |v: [f64; 3]| {
            let most = v.into_iter().fold(f64::NEG_INFINITY, f64::max);
            most - v.into_iter().fold(f64::INFINITY, f64::min)
        };
        self.three(at).map(spread).sum()
    }

    /// Whole numbers, written as such.
    fn is_count(&self, at: usize) -> bool {
        at < self.columns && !self.pointed[at] && self.one(at).all(|x| x.fract() == 0.0)
    }

    /// Whether a column counts the lines.
    fn is_running(&self, at: usize) -> bool {
        let first = self.lines().next().map(|line| line[at]);
        let counts = |(a, b): (&[f64], &[f64])| b[at] == a[at] + 1.0;
        self.is_count(at)
            && matches!(first, Some(0.0 | 1.0))
            && self.values.len() > self.columns
            && self.pairs().all(counts)
    }

    /// Whether a column can be the names of rows: it counts, or is no number.
    pub fn is_row_name(&self, at: usize) -> bool {
        self.is_running(at) || self.is_words(at)
    }

    /// Whether a column has no number at all.
    pub fn is_words(&self, at: usize) -> bool {
        self.one(at).all(f64::is_nan)
    }

    fn is_label(&self, at: usize) -> bool {
        let distinct: HashSet<u64> = self.one(at).map(f64::to_bits).collect();
        self.is_count(at) && distinct.len() <= LABELS
    }

    /// Whether two columns go through a grid, line by line.
    fn are_grid(&self, [a, b]: [usize; 2]) -> bool {
        let is_ordered = |outer: usize, inner: usize| {
            let mut steps = 0;
            let ordered = self.pairs().all(|(one, next)| {
                steps += usize::from(next[outer] == one[outer]);
                next[outer] > one[outer] || next[outer] == one[outer] && next[inner] > one[inner]
            });
            ordered && steps > 0
        };
        let from_zero = |at: usize| self.is_count(at) && self.one(at).all(|x| x >= 0.0);
        from_zero(a) && from_zero(b) && (is_ordered(a, b) || is_ordered(b, a))
    }

    /// Whether three columns can be a place behind columns that are none.
    fn is_place(&self, at: usize) -> bool {
        let pointed = |from: usize| {
            self.pointed
                .iter()
                .skip(from)
                .take(3)
                .filter(|p| **p)
                .count()
        };
        at + 3 <= self.columns && pointed(at) >= 2 && !self.are_normals(at)
    }

    /// The columns before the place.
    fn before_place(&self) -> &'static [&'static str] {
        let is_one_of_several = |at: usize| self.one(at).any(|x| Some(x) != self.one(at).next());
        if self.columns >= 5 && self.are_grid([0, 1]) && self.is_place(2) {
            &["row", "column"]
        } else if self.columns >= 4 && self.is_running(0) && self.is_place(1) {
            &["_"]
        } else if self.columns >= 4
            && self.is_label(0)
            && is_one_of_several(0)
            && self.pointed[1..4] == [true; 3]
            && self.is_place(1)
        {
            &["label"]
        } else if self.columns >= 6
            && (0..3).all(|at| self.is_count(at))
            && self.are_colours(0)
            && self.pointed[3..6] == [true; 3]
            && self.is_place(3)
        {
            &["red", "green", "blue"]
        } else {
            &[]
        }
    }

    /// Names of all columns, the place behind some. Of several colours that could be, the likeliest, or
    /// if that is in doubt and `second` is asked for, the next one.
    fn names(&self, before: &[&'static str], second: bool) -> Vec<String> {
        let mut names = before.to_vec();
        names.extend(["x", "y", "z"]);
        let (mut normals, mut intensity) = (false, false);
        let mut colours = before.contains(&"blue");
        while names.len() < self.columns {
            let at = names.len();
            if !normals && self.are_normals(at) {
                normals = true;
                names.extend(["nx", "ny", "nz"]);
            } else if !colours && self.are_colours(at) && self.likely_colour(at, second) == at {
                colours = true;
                names.extend(["red", "green", "blue"]);
            } else if self.is_alpha(at) && names.last() == Some(&"blue") {
                names.push("alpha");
            } else if names.last() == Some(&"blue") && (self.is_running(at) || self.is_label(at)) {
                names.push("label");
            } else if !intensity {
                intensity = true;
                names.push("intensity");
            } else {
                names.push("_");
            }
        }
        names.into_iter().map(str::to_owned).collect()
    }

    /// Where the colour begins, of the places from `from` on, one after the other, where it could.
    fn likely_colour(&self, from: usize, second: bool) -> usize {
        if self.is_alpha(from + 3) || from + 3 < self.columns && self.is_running(from + 3) {
            return from;
        }
        let places = (from..self.columns).take_while(|&at| self.are_colours(at));
        let mut spreads: Vec<(f64, usize)> = places.map(|at| (self.spread(at), at)).collect();
        // Of equal ones the later.
        spreads.sort_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
        match spreads[..] {
            [(best, _), (next, at), ..] if second && best > DOUBT * next => at,
            [(_, at), ..] => at,
            [] => from,
        }
    }
}

/// The likeliest meaning of columns without names.
pub fn names(sample: &Sample) -> Guess {
    let before = sample.before_place();
    let names = sample.names(before, false);
    let other = match before {
        [] => sample.names(before, true),
        _ => sample.names(&[], false),
    };
    let other = (other != names).then_some(other);
    Guess { names, other }
}
