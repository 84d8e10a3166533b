//! Plots as SVG, for reports.

mod intervals;

pub use intervals::{Difference, intervals};

use std::fmt::Write;

/// One curve.
pub struct Curve {
    /// Name in the legend.
    pub name: String,
    /// Points (x, y); non-finite ones and, on a logarithmic axis, non-positive ones are left out.
    pub points: Vec<(f64, f64)>,
}

/// Axes of a plot.
pub struct Axes<'a> {
    /// Title above.
    pub title: &'a str,
    /// Name and unit of x.
    pub x: &'a str,
    /// Name and unit of y.
    pub y: &'a str,
    /// Whether y is logarithmic.
    pub log_y: bool,
}

impl Axes<'_> {
    /// Their names, and the end of the drawing.
    fn named(&self) -> String {
        let [left, right, top, bottom] = MARGIN;
        format!(
            "<text x=\"{:.1}\" y=\"{:.1}\" class=\"n m\">{}</text><text transform=\"translate(14 {:.1}) rotate(-90)\" class=\"n m\">{}</text></svg>",
            left + (WIDTH - left - right) / 2.0,
            HEIGHT - 8.0,
            escape(self.x),
            top + (HEIGHT - top - bottom) / 2.0,
            escape(self.y),
        )
    }
}

const COLOURS: [&str; 8] = ["#1f5fa8", "#c8502d", "#3b8c4f", "#7a4fa3", "#a0802a", "#2b9a9a", "#b03a6f", "#606060"];
const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 300.0;
const MARGIN: [f64; 4] = [64.0, 150.0, 34.0, 44.0];

/// A plot of a few curves as an `<svg>` element; says so when there is nothing to draw.
pub fn lines(axes: &Axes<'_>, curves: &[Curve]) -> String {
    let [left, right, top, bottom] = MARGIN;
    let value = |y: f64| if axes.log_y { y.log10() } else { y };
    let shown: Vec<Vec<(f64, f64)>> = curves
        .iter()
        .map(|c| {
            let points = c.points.iter().map(|&(x, y)| (x, value(y)));
            points.filter(|(x, y)| x.is_finite() && y.is_finite()).collect()
        })
        .collect();
    let all = || shown.iter().flatten();
    let range = |pick: fn(&(f64, f64)) -> f64| {
        all().map(pick).fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| (lo.min(v), hi.max(v)))
    };
    let ((x0, x1), (y0, y1)) = (range(|p| p.0), range(|p| p.1));
    let mut svg = format!(
        "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" class=\"plot\" role=\"img\"><title>{t}</title><text x=\"{left}\" y=\"20\" class=\"t\">{t}</text>",
        t = escape(axes.title)
    );
    if x0.is_infinite() {
        svg.push_str("<text x=\"80\" y=\"150\">no data</text></svg>");
        return svg;
    }
    let widen = |a: f64, b: f64| if b > a { (a, b) } else { (a - 0.5, b + 0.5) };
    let ((x0, x1), (y0, y1)) = (widen(x0, x1), widen(y0, y1));
    let px = |x: f64| left + (x - x0) / (x1 - x0) * (WIDTH - left - right);
    let py = |y: f64| HEIGHT - bottom - (y - y0) / (y1 - y0) * (HEIGHT - top - bottom);
    for y in ticks(y0, y1) {
        let label = if axes.log_y { 10f64.powf(y) } else { y };
        // Writing to a String cannot fail.
        let _ = write!(
            svg,
            "<line x1=\"{left}\" x2=\"{r}\" y1=\"{yy:.1}\" y2=\"{yy:.1}\" class=\"g\"/><text x=\"{lx}\" y=\"{ty:.1}\" class=\"n e\">{}</text>",
            number(label),
            r = WIDTH - right,
            yy = py(y),
            lx = left - 6.0,
            ty = py(y) + 4.0,
        );
    }
    for x in ticks(x0, x1) {
        let by = HEIGHT - bottom + 16.0;
        let _ = write!(svg, "<text x=\"{:.1}\" y=\"{by}\" class=\"n m\">{}</text>", px(x), number(x));
    }
    for (i, (curve, points)) in curves.iter().zip(&shown).enumerate() {
        let colour = COLOURS[i % COLOURS.len()];
        let path: Vec<String> = points.iter().map(|&(x, y)| format!("{:.1},{:.1}", px(x), py(y))).collect();
        let ly = top + 10.0 + 17.0 * i as f64;
        let _ = write!(
            svg,
            "<polyline points=\"{}\" stroke=\"{colour}\" class=\"c\"/><line x1=\"{a}\" x2=\"{b}\" y1=\"{ly}\" y2=\"{ly}\" stroke=\"{colour}\" class=\"c\"/><text x=\"{c}\" y=\"{d}\" class=\"n\">{}</text>",
            path.join(" "),
            escape(&curve.name),
            a = WIDTH - right + 10.0,
            b = WIDTH - right + 30.0,
            c = WIDTH - right + 35.0,
            d = ly + 4.0,
        );
    }
    svg + &axes.named()
}

/// A map of letters as an `<svg>` element: rows from below, runs of one letter drawn as one.
pub struct Map<'a> {
    /// Title above.
    pub title: &'a str,
    /// Name and unit of x, and labels of columns that have one.
    pub x: (&'a str, Vec<(usize, String)>),
    /// Name and unit of y, and labels of rows that have one.
    pub y: (&'a str, Vec<(usize, String)>),
    /// One letter per cell.
    pub rows: &'a [String],
    /// Letters with their colour and meaning.
    pub legend: &'a [(char, &'a str, &'a str)],
}

/// Side of a map's drawing [px].
const MAP: f64 = 300.0;

impl Map<'_> {
    /// The map; letters without a meaning are left out.
    pub fn svg(&self) -> String {
        let [left, top] = [56.0, 30.0];
        let (rows, columns) = (self.rows.len().max(1), self.rows.first().map_or(1, String::len).max(1));
        let (w, h) = (MAP / columns as f64, MAP / rows as f64);
        let (width, height) = (left + MAP + 20.0, top + MAP + 64.0);
        let text = |x: f64, y: f64, anchor: &str, size: u32, t: &str| {
            format!(
                "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" font-size=\"{size}\" fill=\"#333\">{}</text>",
                escape(t)
            )
        };
        let mut svg = format!(
            "<svg viewBox=\"0 0 {width} {height}\" class=\"map\" role=\"img\" font-family=\"sans-serif\"><title>{}</title>{}",
            escape(self.title),
            text(left + MAP / 2.0, 18.0, "middle", 13, self.title),
        );
        for (r, row) in self.rows.iter().enumerate() {
            let letters: Vec<char> = row.chars().collect();
            let mut from = 0;
            for run in letters.chunk_by(|a, b| a == b) {
                if let Some((_, colour, _)) = self.legend.iter().find(|l| l.0 == run[0]) {
                    let _ = write!(
                        svg,
                        "<rect x=\"{:.2}\" y=\"{:.2}\" width=\"{:.2}\" height=\"{:.2}\" fill=\"{colour}\"/>",
                        left + from as f64 * w,
                        top + (rows - 1 - r) as f64 * h,
                        run.len() as f64 * w + 0.3,
                        h + 0.3,
                    );
                }
                from += run.len();
            }
        }
        for (column, label) in &self.x.1 {
            svg += &text(left + (*column as f64 + 0.5) * w, top + MAP + 14.0, "middle", 10, label);
        }
        for (row, label) in &self.y.1 {
            svg += &text(left - 5.0, top + MAP - (*row as f64 + 0.5) * h + 3.0, "end", 10, label);
        }
        svg += &text(left + MAP / 2.0, top + MAP + 30.0, "middle", 11, self.x.0);
        let _ = write!(
            svg,
            "<text transform=\"translate(13 {:.1}) rotate(-90)\" text-anchor=\"middle\" font-size=\"11\" fill=\"#333\">{}</text>",
            top + MAP / 2.0,
            escape(self.y.0)
        );
        let mut x = left;
        for (_, colour, meaning) in self.legend {
            let y = top + MAP + 44.0;
            let _ = write!(svg, "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"10\" height=\"10\" fill=\"{colour}\"/>");
            svg += &text(x + 13.0, y + 9.0, "start", 10, meaning);
            x += 24.0 + 5.6 * meaning.len() as f64;
        }
        svg + "</svg>"
    }
}

/// Points of one kind in a plot of errors against costs.
pub struct Cloud {
    /// Name in the legend.
    pub name: String,
    /// Cost, error, name of the point.
    pub points: Vec<(f64, f64, String)>,
}

/// Errors against costs, both logarithmic, as an `<svg>` element: a mark per point that tells its name when pointed at, and the
/// front of all points as a line of steps. Points without a positive cost and error are left out.
pub fn costs(axes: &Axes<'_>, clouds: &[Cloud]) -> String {
    let [left, right, top, bottom] = MARGIN;
    let shown = |c: &Cloud| -> Vec<(f64, f64, String)> {
        let good = c.points.iter().filter(|(x, y, _)| *x > 0.0 && *y > 0.0 && x.is_finite() && y.is_finite());
        good.map(|(x, y, name)| (x.log10(), y.log10(), name.clone())).collect()
    };
    let clouds: Vec<(&str, Vec<(f64, f64, String)>)> = clouds.iter().map(|c| (c.name.as_str(), shown(c))).collect();
    let all: Vec<(f64, f64)> = clouds.iter().flat_map(|c| &c.1).map(|p| (p.0, p.1)).collect();
    let title = escape(axes.title);
    let mut svg = format!(
        "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" class=\"plot\" role=\"img\"><title>{title}</title><text x=\"{left}\" y=\"20\" class=\"t\">{title}</text>"
    );
    if all.is_empty() {
        svg.push_str("<text x=\"80\" y=\"150\">no data</text></svg>");
        return svg;
    }
    let range = |pick: fn(&(f64, f64)) -> f64| {
        let (lo, hi) =
            all.iter().map(pick).fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| (lo.min(v), hi.max(v)));
        let room = (0.06 * (hi - lo)).max(0.04);
        (lo - room, hi + room)
    };
    let ((x0, x1), (y0, y1)) = (range(|p| p.0), range(|p| p.1));
    let px = |x: f64| left + (x - x0) / (x1 - x0) * (WIDTH - left - right);
    let py = |y: f64| HEIGHT - bottom - (y - y0) / (y1 - y0) * (HEIGHT - top - bottom);
    for y in decades(y0, y1) {
        // Writing to a String cannot fail.
        let _ = write!(
            svg,
            "<line x1=\"{left}\" x2=\"{r}\" y1=\"{yy:.1}\" y2=\"{yy:.1}\" class=\"g\"/><text x=\"{lx}\" y=\"{ty:.1}\" class=\"n e\">{}</text>",
            number(10f64.powf(y)),
            r = WIDTH - right,
            yy = py(y),
            lx = left - 6.0,
            ty = py(y) + 4.0,
        );
    }
    for x in decades(x0, x1) {
        let by = HEIGHT - bottom + 16.0;
        let _ = write!(svg, "<text x=\"{:.1}\" y=\"{by}\" class=\"n m\">{}</text>", px(x), number(10f64.powf(x)));
    }
    // Cheapest first: a point belongs to the front when nothing cheaper is as good.
    let mut rising = all.clone();
    rising.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let mut steps: Vec<(f64, f64)> = Vec::new();
    for (x, y) in rising {
        match steps.last() {
            Some(&(_, best)) if y >= best => {}
            Some(&(_, best)) => steps.extend([(x, best), (x, y)]),
            None => steps.push((x, y)),
        }
    }
    steps.extend(steps.last().map(|&(_, y)| (x1, y)));
    let path: Vec<String> = steps.iter().map(|&(x, y)| format!("{:.1},{:.1}", px(x), py(y))).collect();
    let _ =
        write!(svg, "<polyline points=\"{}\" stroke=\"#999\" stroke-dasharray=\"4 3\" class=\"c\"/>", path.join(" "));
    for (i, (name, points)) in clouds.iter().enumerate() {
        let colour = COLOURS[i % COLOURS.len()];
        for (x, y, what) in points {
            let _ = write!(
                svg,
                "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"4\" fill=\"{colour}\" fill-opacity=\"0.75\"><title>{}: {}, {}</title></circle>",
                px(*x),
                py(*y),
                escape(what),
                number(10f64.powf(*x)),
                number(10f64.powf(*y)),
            );
        }
        let ly = top + 10.0 + 17.0 * i as f64;
        let _ = write!(
            svg,
            "<circle cx=\"{:.1}\" cy=\"{ly}\" r=\"4\" fill=\"{colour}\"/><text x=\"{:.1}\" y=\"{:.1}\" class=\"n\">{}</text>",
            WIDTH - right + 16.0,
            WIDTH - right + 26.0,
            ly + 4.0,
            escape(name),
        );
    }
    svg + &axes.named()
}

/// Logarithms of round numbers inside a range of logarithms: powers of ten where there are several, else 1, 2, 5 of each, or whatever
/// is round in a narrow range.
fn decades(low: f64, high: f64) -> Vec<f64> {
    let (first, last) = (low.floor() as i32, high.ceil() as i32);
    let inside = |digits: &[f64]| -> Vec<f64> {
        let all = (first..=last).flat_map(|k| digits.iter().map(move |d| f64::from(k) + d.log10()));
        all.filter(|v| (low..=high).contains(v)).collect()
    };
    let powers = inside(&[1.0]);
    let few = inside(&[1.0, 2.0, 5.0]);
    if powers.len() >= 3 {
        powers
    } else if few.len() >= 2 {
        few
    } else {
        ticks(10f64.powf(low), 10f64.powf(high)).into_iter().filter(|v| *v > 0.0).map(f64::log10).collect()
    }
}

/// Round numbers inside a range, about five of them; on a logarithmic axis of the logarithms, so that decades come out.
fn ticks(low: f64, high: f64) -> Vec<f64> {
    let raw = (high - low) / 5.0;
    let decade = 10f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 5.0].into_iter().map(|m| m * decade).find(|s| *s >= 0.999 * raw).unwrap_or(10.0 * decade);
    let (first, last) = ((low / step - 1e-9).ceil() as i64, (high / step + 1e-9).floor() as i64);
    (first..=last).map(|k| k as f64 * step).collect()
}

/// Style of the plots, for the page or file around them.
pub const STYLE: &str = ".plot .t{font-weight:600;font-size:14px}.plot .n{font-size:11px;fill:#555}\
.plot .e{text-anchor:end}.plot .m{text-anchor:middle}.plot .g{stroke:#e6e6e6}.plot .c{fill:none;stroke-width:1.6}";

/// A plot of [`lines`] or a [`Map`] as a file of its own.
pub fn standalone(svg: &str) -> String {
    let view = svg.split("viewBox=\"0 0 ").nth(1).and_then(|rest| rest.split('"').next()).unwrap_or_default();
    let (width, height) = view.split_once(' ').unwrap_or(("560", "300"));
    let family = if svg.contains("font-family") { "" } else { "font-family=\"sans-serif\" " };
    let head = format!("<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" {family}");
    let body = svg.replacen("<svg ", &head, 1);
    body.replacen('>', &format!("><style>{STYLE}</style><rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>"), 1)
}

/// Three significant digits.
pub fn number(v: f64) -> String {
    if v == 0.0 {
        return "0".into();
    }
    let magnitude = v.abs().log10().floor();
    if (-3.0..5.0).contains(&magnitude) {
        let digits = (2.0 - magnitude).max(0.0) as usize;
        let text = format!("{v:.digits$}");
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_string() } else { text }
    } else {
        format!("{v:.2e}")
    }
}

/// Text safe inside HTML.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn costs_show_their_front() {
        let axes = Axes { title: "t", x: "s", y: "mm", log_y: true };
        assert!(costs(&axes, &[]).contains("no data"));
        let point = |x: f64, y: f64, name: &str| (x, y, name.to_string());
        let points = vec![point(1.0, 8.0, "a<"), point(10.0, 9.0, "b"), point(100.0, 2.0, "c"), point(5.0, 0.0, "d")];
        let svg = costs(&axes, &[Cloud { name: "nets".into(), points }]);
        // Three points and the legend's; the front goes from the first down to the third and on.
        assert_eq!(svg.matches("<circle").count(), 4);
        let line = svg.split("<polyline points=\"").nth(1).and_then(|rest| rest.split('"').next()).unwrap();
        assert_eq!(line.split(' ').count(), 4, "{line}");
        assert!(svg.contains("a&lt;: 1, 8") && !svg.contains("NaN"), "{svg}");
        assert_eq!(decades(-0.1, 2.2), [0.0, 1.0, 2.0]);
        assert_eq!(decades(0.1, 0.8).len(), 2);
        assert!(decades(12f64.log10(), 12.5f64.log10()).len() >= 4);
    }

    #[test]
    fn plots_survive_nothing_constants_and_bad_values() {
        let axes = Axes { title: "a < b", x: "x", y: "y", log_y: true };
        assert!(lines(&axes, &[]).contains("no data"));
        let curve = Curve { name: "c".into(), points: vec![(0.0, f64::NAN), (1.0, 0.0), (2.0, 5.0)] };
        let svg = lines(&axes, &[curve]);
        assert!(svg.contains("a &lt; b") && !svg.contains("NaN"), "{svg}");
        assert_eq!(ticks(0.0, 1.0), [0.0, 0.2, 0.4, 0.6000000000000001, 0.8, 1.0]);
        assert_eq!(ticks(1.0, 1.25).len(), 6);
        assert!(ticks(-3.2, 4.1).contains(&0.0));
        assert_eq!([number(0.0), number(1234.0), number(0.05), number(1e-9)], ["0", "1234", "0.05", "1.00e-9"]);
    }
}
