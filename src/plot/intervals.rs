//! Differences with their intervals, one row each, beside what others found.

use super::{COLOURS, escape, number, ticks};
use crate::ablation::Interval;
use std::fmt::Write;

/// A row of the plot.
pub struct Difference {
    /// What is compared, on the left.
    pub name: String,
    /// Change and where it may lie, as a share.
    pub change: Interval,
    /// The same of others, as shares: drawn as hollow marks.
    pub others: Vec<f64>,
}

/// Width of the drawing with names on its left [px], where the names end, and room at its right.
const WIDTH: f64 = 560.0;
const NAMES: f64 = 222.0;
const RIGHT: f64 = 24.0;
/// Where the legend begins [px], and its second entry.
const LEGEND: [f64; 2] = [18.0, 218.0];
/// Heights [px]: of a row, above the first, below the last.
const ROW: f64 = 24.0;
const ABOVE: f64 = 52.0;
const BELOW: f64 = 44.0;

/// Changes in per cent as an `<svg>` element: a dot per row, a bar where 95 % of the draws lie, hollow marks for what `others` names.
/// Rows without a finite change are left out.
pub fn intervals(title: &str, axis: &str, others: &str, rows: &[Difference]) -> String {
    let rows: Vec<&Difference> = rows.iter().filter(|row| row.change.value.is_finite()).collect();
    let height = ABOVE + ROW * rows.len() as f64 + BELOW;
    let title = escape(title);
    let mut svg = format!(
        "<svg viewBox=\"0 0 {WIDTH} {height}\" class=\"plot\" role=\"img\"><title>{title}</title><text x=\"12\" y=\"20\" class=\"t\">{title}</text>"
    );
    if rows.is_empty() {
        svg.push_str("<text x=\"12\" y=\"60\">no data</text></svg>");
        return svg;
    }
    // No change is always in the picture.
    let ends = rows.iter().flat_map(|row| {
        let own = [row.change.value].into_iter().chain(row.change.interval.into_iter().flatten());
        own.chain(row.others.iter().copied()).filter(|v| v.is_finite())
    });
    let (low, high) = ends.fold((0.0f64, 0.0f64), |(low, high), v| (low.min(v), high.max(v)));
    let room = (0.05 * (high - low)).max(0.005);
    let (low, high) = (100.0 * (low - room), 100.0 * (high + room));
    let px = |share: f64| NAMES + (100.0 * share - low) / (high - low) * (WIDTH - NAMES - RIGHT);
    let bottom = height - BELOW;
    for tick in ticks(low, high) {
        let x = px(tick / 100.0);
        let zero = tick == 0.0;
        // Writing to a String cannot fail.
        let _ = write!(
            svg,
            "<line x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{:.1}\" y2=\"{bottom:.1}\" {}/><text x=\"{x:.1}\" y=\"{:.1}\" class=\"n m\">{}</text>",
            ABOVE - 8.0,
            if zero { "stroke=\"#777\"" } else { "class=\"g\"" },
            bottom + 16.0,
            if zero { "0".into() } else { format!("{}{}", if tick > 0.0 { "+" } else { "−" }, number(tick.abs())) },
        );
    }
    let [own, paper] = [COLOURS[0], COLOURS[1]];
    for (i, row) in rows.iter().enumerate() {
        let y = ABOVE + ROW * (i as f64 + 0.5);
        let _ = write!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\" class=\"n e\">{}</text>",
            NAMES - 10.0,
            y + 4.0,
            escape(&row.name)
        );
        if let Some([from, to]) = row.change.interval {
            let [from, to] = [px(from), px(to)];
            let _ = write!(
                svg,
                "<path d=\"M{from:.1} {y:.1}H{to:.1}M{from:.1} {a:.1}V{b:.1}M{to:.1} {a:.1}V{b:.1}\" stroke=\"{own}\" class=\"c\"/>",
                a = y - 4.0,
                b = y + 4.0,
            );
        }
        for other in row.others.iter().filter(|v| v.is_finite()) {
            let x = px(*other);
            let _ = write!(
                svg,
                "<path d=\"M{:.1} {y:.1}L{x:.1} {:.1}L{:.1} {y:.1}L{x:.1} {:.1}Z\" stroke=\"{paper}\" class=\"c\"/>",
                x - 5.0,
                y - 5.0,
                x + 5.0,
                y + 5.0,
            );
        }
        let _ = write!(svg, "<circle cx=\"{:.1}\" cy=\"{y:.1}\" r=\"4\" fill=\"{own}\"/>", px(row.change.value));
    }
    let _ = write!(
        svg,
        "<circle cx=\"{:.1}\" cy=\"34\" r=\"4\" fill=\"{own}\"/><text x=\"{:.1}\" y=\"38\" class=\"n\">measured, 95 % of the draws</text>",
        LEGEND[0],
        LEGEND[0] + 10.0
    );
    if rows.iter().any(|row| !row.others.is_empty()) {
        let x = LEGEND[1];
        let _ = write!(
            svg,
            "<path d=\"M{:.1} 34L{x:.1} 29L{:.1} 34L{x:.1} 39Z\" stroke=\"{paper}\" class=\"c\"/><text x=\"{:.1}\" y=\"38\" class=\"n\">{}</text>",
            x - 5.0,
            x + 5.0,
            x + 10.0,
            escape(others)
        );
    }
    let middle = NAMES + (WIDTH - NAMES - RIGHT) / 2.0;
    let _ =
        write!(svg, "<text x=\"{middle:.1}\" y=\"{:.1}\" class=\"n m\">{}</text></svg>", height - 8.0, escape(axis));
    svg
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_shows_its_change_its_interval_and_what_others_found() {
        assert!(intervals("t", "x", "paper", &[]).contains("no data"));
        let row = |name: &str, value: f64, interval: Option<[f64; 2]>, others: Vec<f64>| Difference {
            name: name.into(),
            change: Interval { value, interval },
            others,
        };
        let rows = [
            row("a < b", 0.5, Some([0.4, 0.7]), vec![0.6, f64::NAN]),
            row("one scan", -0.1, None, vec![]),
            row("nothing", f64::NAN, None, vec![]),
        ];
        let svg = intervals("t", "change, %", "paper", &rows);
        // Two dots and the legend's; a bar; a mark and the legend's.
        assert_eq!((svg.matches("<circle").count(), svg.matches("<path").count()), (3, 3), "{svg}");
        assert!(
            svg.contains("a &lt; b") && !svg.contains("NaN") && svg.contains(">+20<") && svg.contains(">0<"),
            "{svg}"
        );
        // In the order of their values from left to right.
        let x = |part: &str| -> f64 { part.split('"').next().and_then(|v| v.parse().ok()).unwrap() };
        let dots: Vec<f64> = svg.split("<circle cx=\"").skip(1).map(x).collect();
        assert!(dots[1] < dots[0], "{dots:?}");
    }
}
