//! Colours of scans on the avatar: vertex colours, the simplest form of the paper's Fig. 8.
//!
//! Every vertex, posed as in a scan, takes the colour of the scan point next to it that belongs to the same part and faces the same way;
//! of all scans that show it, the median per channel. Light is part of these colours: scanners record it.

use caphy_core::query::{Adjacency, NearestGrid};
use caphy_core::{Vec3, mesh};

/// A scan point farther away than this is another place [m].
const REACH: f64 = 0.03;
/// Least cosine between the normals of a vertex and its point.
const FACING: f64 = 0.5;

/// Points of one part of a scan.
pub struct ColouredPoints {
    points: Vec<Vec3>,
    normals: Vec<Vec3>,
    colours: Vec<[u8; 3]>,
    grid: NearestGrid<f64>,
}

impl ColouredPoints {
    /// Points [m] with their normals and colours (sRGB), all of the same number.
    pub fn new(points: Vec<Vec3>, normals: Vec<Vec3>, colours: Vec<[u8; 3]>) -> Self {
        let grid = NearestGrid::from_points(&points);
        Self { points, normals, colours, grid }
    }
}

/// Colours of one part's vertices, gathered over scans.
pub struct PartColours {
    found: Vec<Vec<[u8; 3]>>,
}

impl PartColours {
    /// Nothing seen yet.
    pub fn new(vertex_count: usize) -> Self {
        Self { found: vec![Vec::new(); vertex_count] }
    }

    /// Looks at the part as one scan shows it; `vertices` [m] are posed as in that scan.
    pub fn see(&mut self, vertices: &[Vec3], faces: &[[u32; 3]], scan: &ColouredPoints) {
        let normals = mesh::vertex_normals(vertices, faces);
        for ((found, p), normal) in self.found.iter_mut().zip(vertices).zip(&normals) {
            let Some((id, _)) = scan.grid.nearest_within(&[p.x, p.y, p.z], REACH * REACH) else { continue };
            let id = id as usize;
            if id < scan.points.len() && scan.normals[id].dot(normal) > FACING {
                found.push(scan.colours[id]);
            }
        }
    }

    /// Share of vertices that a scan showed.
    pub fn seen(&self) -> f64 {
        self.found.iter().filter(|f| !f.is_empty()).count() as f64 / self.found.len().max(1) as f64
    }

    /// A colour per vertex; those that no scan showed take their neighbours'. `None` when none was shown.
    pub fn finish(&self, faces: &[[u32; 3]]) -> Option<Vec<[u8; 3]>> {
        let mut known: Vec<Option<[f64; 3]>> = self.found.iter().map(|list| median(list)).collect();
        let seen: Vec<[f64; 3]> = known.iter().flatten().copied().collect();
        let mean = average(&seen)?;
        let neighbours = Adjacency::new(known.len(), faces);
        // From the border of what is known inwards, a ring of vertices at a time.
        loop {
            let next: Vec<(usize, [f64; 3])> = (0..known.len())
                .filter(|&v| known[v].is_none())
                .filter_map(|v| {
                    let around: Vec<[f64; 3]> = neighbours.of(v).iter().filter_map(|&n| known[n as usize]).collect();
                    Some((v, average(&around)?))
                })
                .collect();
            if next.is_empty() {
                break;
            }
            next.into_iter().for_each(|(v, colour)| known[v] = Some(colour));
        }
        // Casts to u8 round towards zero and saturate.
        Some(known.iter().map(|c| c.unwrap_or(mean).map(|x| (x + 0.5) as u8)).collect())
    }
}

/// Median per channel.
fn median(list: &[[u8; 3]]) -> Option<[f64; 3]> {
    if list.is_empty() {
        return None;
    }
    Some(std::array::from_fn(|k| {
        let mut channel: Vec<u8> = list.iter().map(|c| c[k]).collect();
        channel.sort_unstable();
        let (low, high) = (channel[(channel.len() - 1) / 2], channel[channel.len() / 2]);
        0.5 * (f64::from(low) + f64::from(high))
    }))
}

fn average(list: &[[f64; 3]]) -> Option<[f64; 3]> {
    let count = list.len();
    (count > 0).then(|| std::array::from_fn(|k| list.iter().map(|c| c[k]).sum::<f64>() / count as f64))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A strip of 20 cells of 1 cm in the plane z = 0, facing +z.
    fn strip() -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let at = |i: u32, j: u32| Vec3::new(0.01 * f64::from(i), 0.01 * f64::from(j), 0.0);
        let vertices = (0..=20).flat_map(|i| [at(i, 0), at(i, 1)]).collect();
        let faces =
            (0..20u32).flat_map(|i| [[2 * i, 2 * i + 2, 2 * i + 1], [2 * i + 2, 2 * i + 3, 2 * i + 1]]).collect();
        (vertices, faces)
    }

    fn scan(z: f64, facing: f64, colour: impl Fn(&Vec3) -> [u8; 3]) -> ColouredPoints {
        let points: Vec<Vec3> = strip().0.iter().map(|p| p + Vec3::new(0.001, 0.0, z)).collect();
        let colours = points.iter().map(colour).collect();
        let normals = vec![Vec3::z() * facing; points.len()];
        ColouredPoints::new(points, normals, colours)
    }

    #[test]
    fn colours_are_medians_of_what_is_near_and_faces_the_same_way() {
        let (vertices, faces) = strip();
        let mut part = PartColours::new(vertices.len());
        assert_eq!(part.finish(&faces), None);
        part.see(&vertices, &faces, &scan(0.005, 1.0, |_| [100, 0, 0]));
        part.see(&vertices, &faces, &scan(-0.005, 1.0, |_| [120, 0, 0]));
        // One scan in which something went wrong.
        part.see(&vertices, &faces, &scan(0.002, 1.0, |_| [0, 255, 255]));
        // Too far away, and the other side of a fold.
        part.see(&vertices, &faces, &scan(0.05, 1.0, |_| [255; 3]));
        part.see(&vertices, &faces, &scan(0.001, -1.0, |_| [255; 3]));
        assert_eq!(part.seen(), 1.0);
        assert!(part.finish(&faces).unwrap().iter().all(|c| *c == [100, 0, 0]));
    }

    #[test]
    fn what_no_scan_shows_takes_its_neighbours_colours() {
        let (vertices, faces) = strip();
        let mut part = PartColours::new(vertices.len() + 1);
        let mut posed = vertices.clone();
        // A vertex without a triangle, far from everything.
        posed.push(Vec3::repeat(9.0));
        // Only the two ends are shown: red on the left, blue on the right.
        let whole = scan(0.0, 1.0, |p| if p.x < 0.1 { [200, 0, 0] } else { [0, 0, 200] });
        let ends: Vec<usize> =
            (0..whole.points.len()).filter(|&i| whole.points[i].x < 0.02 || whole.points[i].x > 0.19).collect();
        let pick = |list: &[Vec3]| ends.iter().map(|&i| list[i]).collect::<Vec<_>>();
        let colours = ends.iter().map(|&i| whole.colours[i]).collect();
        part.see(&posed, &faces, &ColouredPoints::new(pick(&whole.points), pick(&whole.normals), colours));
        assert!(part.seen() < 0.7);
        let got = part.finish(&faces).unwrap();
        assert_eq!((got[0], got[41]), ([200, 0, 0], [0, 0, 200]));
        assert!(got[10][0] > got[10][2] && got[32][2] > got[32][0]);
        // The lonely vertex has the mean of all that were shown.
        assert!(got[42][0] > 50 && got[42][2] > 50, "{:?}", got[42]);
    }
}
