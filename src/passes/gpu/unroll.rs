//! Loops over multi-indices in WGSL, written out.
//!
//! The stages on expansions are sums over multi-indices α = (αx, αy, αz). Their WGSL says so, with
//! loops that no WGSL compiler knows, and this module writes the loops out: all indices become
//! numbers, so that coefficients live in registers and not in arrays that are indexed at run time
//! (which software Vulkan reads a lane at a time, and a GPU keeps in slow memory).
//!
//! ```text
//! #for a of degree 0..=ORDER        all multi-indices of these degrees, in the order of the crate
//! #for k in axes                    0, 1, 2
//! #for d in 0..=ORDER               numbers; a bound is a sum of numbers, |a| and ORDER
//! #end
//! ```
//!
//! Inside, x, y and z are axes, `$k` is a number, `$a` the number of a multi-index in the order of the
//! crate, `$|a|` its degree, `$a!` its factorial (αx! αy! αz!), `$(a+b)` the number of a sum; an axis
//! counts as a unit vector in it. `$(a,k)` is the place of component k of index a among the
//! coefficients of an expansion, `$(a,i,k)` that of entry (i, k) of a 3 by 3 matrix; `$(a over b)` is
//! the binomial coefficient of multi-indices.

use std::collections::HashMap;
use std::fmt::Write;

use crate::expansion::{Indices, count, position};

/// A multi-index.
type Index = [u8; 3];

#[derive(Clone, Copy)]
enum Value {
    Index(Index),
    Axis(usize),
    Number(usize),
}

type Values<'a> = HashMap<&'a str, Value>;

/// Multi-indices of one degree, in order.
fn of_degree(degree: usize) -> Vec<Index> {
    let all = Indices::new(degree);
    all.exponents()[Indices::of_degree(degree)].to_vec()
}

fn degree(a: Index) -> usize {
    a.into_iter().map(usize::from).sum()
}

fn factorial(n: u8) -> usize {
    (1..=usize::from(n)).product()
}

/// Writes out the loops of a text for expansions of one order.
pub fn unroll(text: &str, order: usize) -> String {
    let mut out = String::new();
    let lines: Vec<&str> = text.lines().collect();
    let values = HashMap::from([
        ("ORDER", Value::Number(order)),
        ("x", Value::Axis(0)),
        ("y", Value::Axis(1)),
        ("z", Value::Axis(2)),
    ]);
    write_out(&lines, &values, &mut out);
    out
}

fn write_out<'a>(lines: &[&'a str], values: &Values<'a>, out: &mut String) {
    let mut at = 0;
    while at < lines.len() {
        let Some(head) = lines[at].trim().strip_prefix("#for ") else {
            substitute(lines[at], values, out);
            at += 1;
            continue;
        };
        let end = at + block(&lines[at..]);
        let (name, range) = head.split_once(' ').unwrap_or((head, ""));
        for value in range_values(range, values) {
            let mut inner = values.clone();
            inner.insert(name, value);
            write_out(&lines[at + 1..end], &inner, out);
        }
        at = end + 1;
    }
}

/// Lines from a `#for` to its `#end`.
fn block(lines: &[&str]) -> usize {
    let mut depth = 0;
    for (k, line) in lines.iter().enumerate() {
        match line.trim() {
            "#end" => depth -= 1,
            head if head.starts_with("#for ") => depth += 1,
            _ => {}
        }
        if depth == 0 {
            return k;
        }
    }
    lines.len()
}

fn range_values(range: &str, values: &Values) -> Vec<Value> {
    if range == "in axes" {
        return (0..3).map(Value::Axis).collect();
    }
    let bounds = range.rsplit(' ').next().unwrap_or("");
    let (from, to) = bounds.split_once("..=").unwrap_or(("1", "0"));
    let numbers = bound(from, values)..=bound(to, values);
    let numbers = numbers.filter_map(|n| usize::try_from(n).ok());
    if range.starts_with("of degree") {
        numbers.flat_map(of_degree).map(Value::Index).collect()
    } else {
        numbers.map(Value::Number).collect()
    }
}

/// A sum of numbers, `ORDER` and degrees, with signs.
fn bound(text: &str, values: &Values) -> isize {
    let signed = text.replace('-', "+-");
    let term = |term: &str| {
        let (sign, name) = match term.strip_prefix('-') {
            Some(name) => (-1, name),
            None => (1, term),
        };
        let number = name
            .parse()
            .unwrap_or_else(|_| match values.get(name.trim_matches('|')) {
                Some(&Value::Index(a)) => degree(a),
                Some(&Value::Number(n)) => n,
                _ => 0,
            });
        sign * number as isize
    };
    signed.split('+').map(term).sum()
}

/// Appends a line with all `$` replaced. What cannot be evaluated stays, and is no valid WGSL.
fn substitute(line: &str, values: &Values, out: &mut String) {
    let mut parts = line.split('$');
    out.push_str(parts.next().unwrap_or(""));
    for part in parts {
        let (expression, rest) = if let Some(inner) = part.strip_prefix('(') {
            inner.split_once(')').unwrap_or((inner, ""))
        } else {
            let end = part.find(|c: char| !c.is_alphanumeric() && !"|!".contains(c));
            part.split_at(end.unwrap_or(part.len()))
        };
        let _ = match evaluate(expression, values) {
            Some(number) => write!(out, "{number}{rest}"),
            None => write!(out, "${part}"),
        };
    }
    out.push('\n');
}

fn evaluate(expression: &str, values: &Values) -> Option<usize> {
    if let Some(name) = expression.strip_suffix('!') {
        return Some(sum(name, values)?.map(factorial).into_iter().product());
    }
    if let Some(name) = expression.strip_prefix('|') {
        return Some(degree(sum(name.strip_suffix('|')?, values)?));
    }
    if let Some((a, b)) = expression.split_once(" over ") {
        let (a, b) = (sum(a, values)?, sum(b, values)?);
        let rest: Option<Vec<u8>> = (0..3).map(|k| a[k].checked_sub(b[k])).collect();
        let choose = |(k, rest)| factorial(a[k]) / factorial(b[k]) / factorial(rest);
        return Some(rest?.into_iter().enumerate().map(choose).product());
    }
    let axis = |name: &str| match values.get(name) {
        Some(&Value::Axis(k)) => Some(k),
        _ => None,
    };
    let parts: Vec<&str> = expression.split(',').collect();
    match (&parts[..], values.get(expression)) {
        (_, Some(&Value::Number(n) | &Value::Axis(n))) => Some(n),
        ([a, k], _) => Some(1 + 3 * position(sum(a, values)?) + axis(k)?),
        ([a, i, k], _) => Some(9 * position(sum(a, values)?) + 3 * axis(i)? + axis(k)?),
        _ => Some(position(sum(expression, values)?)),
    }
}

fn sum(text: &str, values: &Values) -> Option<Index> {
    let mut sum = [0; 3];
    for name in text.split('+') {
        match values.get(name)? {
            Value::Index(a) => (0..3).for_each(|k| sum[k] += a[k]),
            Value::Axis(k) => sum[*k] += 1,
            Value::Number(_) => return None,
        }
    }
    Some(sum)
}

/// WGSL of the derivatives ∂^γ log r up to `most`-th order at distance 1 from the origin.
///
/// Deriving r² ∂_i log r = x_i by γ - e_i gives, with γ' = γ - e_i and r = 1,
/// ∂^γ = δ - Σ_m [2 γ'_m x_m ∂^(γ - e_m) + γ'_m (γ'_m - 1) ∂^(γ - 2e_m)], where δ is 1 for γ = 2e_i
/// and 0 else. Of the axes i that γ allows, the one with the fewest terms is taken.
pub fn derivatives(most: usize) -> String {
    let mut out = format!(
        "fn derivatives(x: vec3<f32>) -> array<f32, {0}> {{\n    var g: array<f32, {0}>;\n",
        count(most)
    );
    let less = |mut a: Index, m: usize, by: u8| {
        a[m] -= by;
        position(a)
    };
    for gamma in (1..=most).flat_map(of_degree) {
        let axes = (0..3).filter(|&k| gamma[k] > 0);
        let i = axes.min_by_key(|&k| gamma[k]).unwrap_or(0);
        let _ = write!(out, "    g[{}] = ", position(gamma));
        let mut others = gamma;
        others[i] -= 1;
        let start = match (degree(gamma), gamma[i]) {
            (1, _) => format!("x[{i}]"),
            (2, 2) => "1.0".to_owned(),
            _ => String::new(),
        };
        out.push_str(&start);
        for m in 0..3 {
            let n = others[m];
            if n > 0 {
                let _ = write!(out, " - {}.0 * x[{m}] * g[{}]", 2 * n, less(gamma, m, 1));
            }
            if n > 1 {
                let _ = write!(out, " - {}.0 * g[{}]", n * (n - 1), less(gamma, m, 2));
            }
        }
        out.push_str(";\n");
    }
    out + "    return g;\n}\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_makes_no_sense_stays() {
        let text = "#for a of degree 0..=1\n$b $(a+c) $(a,b)\n#end\n$a";
        let line = "$b $(a+c) $(a,b)\n";
        assert_eq!(unroll(text, 1), line.repeat(4) + "$a\n");
    }

    #[test]
    fn loops_are_written_out() {
        let text = "\
            #for a of degree 1..=ORDER\n\
            #for k in axes\n\
            $|a| $(a,k)\n\
            #end\n\
            #for b of degree 0..=ORDER-|a|\n\
            + $(a+b over b) $(a+a)! $b\n\
            #end\n\
            #end\n\
            #for d in 0..=ORDER\n\
            $d\n\
            #end";
        let expected = "\
            1 4\n1 5\n1 6\n+ 1 4! 0\n\
            1 7\n1 8\n1 9\n+ 1 7! 0\n\
            1 10\n1 11\n1 12\n+ 1 9! 0\n\
            0\n1\n";
        assert_eq!(unroll(text, 1), expected);
    }
}
