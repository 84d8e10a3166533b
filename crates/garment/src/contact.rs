//! Which part of the body a garment vertex can touch.
//!
//! Captured motion moves hands and forearms through the trunk. Were every body vertex a candidate, cloth at the belly would find
//! a forearm inside the body nearest and be dragged out around it. A garment vertex therefore only meets the skin that lies
//! near its own and faces its way, measured in the T-pose; what it leaves out is contact across limbs (a hand on a hip), which a
//! penalty on nearest vertices cannot resolve anyway. In an armpit, which closes where an arm comes down, every vertex so has
//! skin of its own: were all of an arm's underside one, cloth there would meet the front of the shoulder and be torn to it.

use crate::energy::NoNearest;
use caphy_core::body::BlendWeights;
use caphy_core::lanes::Frames;
use caphy_core::query::{Asked, LaneAnswers, NearestGrid, NearestInLanes};
use caphy_core::{Error, Real, Result, Vec3};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Garment vertices with the same dominant joint that face the same way, and the body vertices that some of them can touch: they are
/// searched together.
#[derive(Debug, Clone, PartialEq)]
struct Region {
    garment: Vec<u32>,
    body: NearestInLanes,
    /// Where the search of each garment vertex begins.
    home: Vec<u32>,
    /// What each of them can touch, `[garment vertex][group]`, see [`NearestInLanes::mask`].
    may: Vec<u8>,
}

/// Cosine of the largest angle between the skin under a garment vertex and the skin that it can touch, in the T-pose: 73°, so that
/// the side of the trunk (facing sideways) and the underside of the arm (facing down) do not meet. On an arm of 5 cm radius
/// cloth may slide by 6 cm.
const FACING: f64 = 0.3;

/// Which of six axes a normal is nearest to.
fn direction(normal: &Vec3) -> usize {
    let axis = normal.iamax();
    2 * axis + usize::from(normal[axis] < 0.0)
}

/// Candidates for contact, fixed in the T-pose.
#[derive(Debug, Clone, PartialEq)]
pub struct ContactMap {
    regions: Vec<Region>,
    garment_count: usize,
    body_count: usize,
    /// Vertices behind the body's that everybody can touch.
    obstacle_count: usize,
}

impl ContactMap {
    /// For a template with its weights and a T-posed body (its reachable part, in the order of the frames to come, with its unit
    /// normals): a vertex's candidates lie within `distance` [m] of it and face as the skin nearest to it does, within 73°, or are that
    /// skin where there are none.
    ///
    /// # Errors
    /// [`Error::Length`] for other weights than vertices or normals than body vertices, [`Error::Mesh`] for a body without vertices.
    pub fn new(
        template: &[Vec3],
        weights: &BlendWeights,
        body: &[Vec3],
        normals: &[Vec3],
        distance: f64,
    ) -> Result<Self> {
        Error::check_length("rows of garment weights", template.len(), weights.vertex_count())?;
        Error::check_length("normals of the T-posed body", body.len(), normals.len())?;
        let whole = NearestGrid::from_points(body);
        // Vertices that share a joint and face about the same way share most of their candidates.
        let mut groups: BTreeMap<(usize, usize), Vec<(u32, u32)>> = BTreeMap::new();
        for (v, point) in template.iter().enumerate() {
            let strongest = weights.row(v).fold((0, 0.0), |best, (j, w)| if w > best.1 { (j, w) } else { best });
            let Some((home, _)) = whole.nearest_point(point) else {
                return Err(Error::mesh("body", "whole surface", "has no vertices", "give the body's surface"));
            };
            let facing = direction(&normals[home as usize]);
            groups.entry((strongest.0, facing)).or_default().push((v as u32, home));
        }
        let regions = groups
            .into_values()
            .map(|members| {
                let touches = |&(v, home): &(u32, u32)| -> Vec<u32> {
                    let (point, facing) = (&template[v as usize], &normals[home as usize]);
                    let near = |b: &usize| {
                        (body[*b] - point).norm_squared() < distance * distance && normals[*b].dot(facing) > FACING
                    };
                    let ids: Vec<u32> = (0..body.len()).filter(near).map(|b| b as u32).collect();
                    if ids.is_empty() { vec![home] } else { ids }
                };
                let touched: Vec<Vec<u32>> = members.par_iter().map(touches).collect();
                let mut ids = touched.concat();
                ids.sort_unstable();
                ids.dedup();
                let search = NearestInLanes::new(body, &ids);
                let own = |((v, _), own): (&(u32, u32), &Vec<u32>)| {
                    let may = |id: u32| own.binary_search(&id).is_ok();
                    (search.home(body, &template[*v as usize], may), search.mask(may))
                };
                let (home, may): (Vec<u32>, Vec<Vec<u8>>) = members.par_iter().zip(&touched).map(own).unzip();
                Region { garment: members.iter().map(|m| m.0).collect(), body: search, home, may: may.concat() }
            })
            .collect();
        Ok(Self { regions, garment_count: template.len(), body_count: body.len(), obstacle_count: 0 })
    }

    /// The same with further obstacle vertices behind the body's, which every garment vertex can touch: another garment.
    pub fn with_obstacle(mut self, vertices: usize) -> Self {
        self.obstacle_count += vertices;
        self
    }

    /// Nearest candidate of each garment vertex, `[block][garment vertex][lane]`; spare lanes repeat the last frame: the
    /// `nearest` of [`crate::energy::BodyState`]. Exact, equal distances to the smallest id.
    ///
    /// # Errors
    /// [`Error::Length`] for other garments or bodies, [`Error::Numerics`] naming a garment vertex that is not finite.
    pub fn nearest<T: Real>(&self, garment: &Frames<T>, body: &Frames<T>) -> Result<Vec<u32>> {
        let mut out = Vec::new();
        self.nearest_into(garment, body, &mut out)?;
        Ok(out)
    }

    /// [`ContactMap::nearest`] into a buffer that is used again and again.
    ///
    /// # Errors
    /// As [`ContactMap::nearest`].
    pub fn nearest_into<T: Real>(&self, garment: &Frames<T>, body: &Frames<T>, out: &mut Vec<u32>) -> Result<()> {
        let points = self.body_count + self.obstacle_count;
        Error::check_length("garment vertices of the contact map", self.garment_count, garment.vertices())?;
        Error::check_length("body vertices of the contact map", points, body.vertices())?;
        Error::check_length("body frames of the contact search", garment.frames(), body.frames())?;
        Error::check_length("body lanes of the contact search", garment.lanes_used(), body.lanes_used())?;
        let (lanes, n) = (garment.lanes_used(), garment.vertices());
        out.resize(garment.blocks() * n * T::LANES, 0);
        // The obstacle's shape is only known now: it is grouped as it lies in the first frame.
        let obstacle = (self.obstacle_count > 0 && body.blocks() > 0).then(|| {
            NearestInLanes::new(&body.frame(0, 0), &(self.body_count as u32..points as u32).collect::<Vec<_>>())
        });
        let obstacle_boxes: Vec<_> = obstacle
            .iter()
            .flat_map(|search| (0..body.blocks()).map(|block| search.boxes(body.block(block))))
            .collect();
        let tasks: Vec<(usize, &Region)> =
            (0..garment.blocks()).flat_map(|block| self.regions.iter().map(move |region| (block, region))).collect();
        let found: Vec<Vec<u32>> = tasks
            .par_iter()
            .map(|&(block, region)| {
                let (cloth, skin) = (garment.block(block), body.block(block));
                let mut answers = LaneAnswers::none(region.garment.len());
                let boxes = region.body.boxes(skin);
                let rows = &region.garment[..];
                let asked = Asked { rows, home: Some(&region.home), may: Some(&region.may) };
                region.body.search(skin, &boxes, cloth, asked, &mut answers);
                if let Some(obstacle) = &obstacle {
                    let asked = Asked { rows, home: None, may: None };
                    obstacle.search(skin, &obstacle_boxes[block], cloth, asked, &mut answers);
                }
                answers.ids
            })
            .collect();
        for ((block, region), found) in tasks.iter().zip(&found) {
            let rows = &mut out[block * n * T::LANES..][..n * T::LANES];
            for (&v, ids) in region.garment.iter().zip(found.chunks_exact(T::LANES)) {
                let row = &mut rows[v as usize * T::LANES..][..T::LANES];
                row[..lanes].copy_from_slice(&ids[..lanes]);
                row[lanes..].fill(ids[lanes - 1]);
            }
        }
        match out.iter().position(|&id| id == u32::MAX) {
            None => Ok(()),
            Some(at) => {
                let (block, v, lane) = (at / (n * T::LANES), at / T::LANES % n, (at % T::LANES).min(lanes - 1));
                let x = garment.get(block, lane, v);
                let problem =
                    if x.iter().all(|c| c.is_finite()) { NoNearest::Empty } else { NoNearest::Query(v, x.into()) };
                Err(problem.into_error(block, lane))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::energy::{lane_points, nearest_body_vertices};

    /// A trunk (joint 0) and a forearm (joint 1) far from it in the T-pose.
    fn scene() -> (Vec<Vec3>, BlendWeights, Vec<Vec3>) {
        let trunk: Vec<Vec3> = (0..10).map(|i| Vec3::new(0.0, 0.1 * i as f64, 0.1)).collect();
        let arm: Vec<Vec3> = (0..5).map(|i| Vec3::new(0.8 + 0.1 * i as f64, 0.9, 0.0)).collect();
        let body: Vec<Vec3> = trunk.iter().chain(&arm).copied().collect();
        let shirt: Vec<Vec3> = trunk.iter().map(|p| p + Vec3::new(0.0, 0.0, 0.01)).collect();
        let weights = BlendWeights::from_rows(shirt.iter().map(|_| vec![(0u16, 1.0)]));
        (shirt, weights, body)
    }

    #[test]
    fn a_forearm_inside_the_trunk_does_not_attract_the_shirt() {
        let (shirt, weights, body) = scene();
        let map = ContactMap::new(&shirt, &weights, &body, &vec![Vec3::z(); body.len()], 0.1).unwrap();
        let mut posed = body.clone();
        for (i, p) in posed[10..].iter_mut().enumerate() {
            *p = shirt[i] + Vec3::new(0.001, 0.0, 0.0);
        }
        let mut garment = Frames::<f64>::zeros(1, 10, 1);
        garment.set_frame(0, 0, &shirt).unwrap();
        let mut frames = Frames::<f64>::zeros(1, 15, 1);
        frames.set_frame(0, 0, &posed).unwrap();
        let nearest = map.nearest(&garment, &frames).unwrap();
        assert!(nearest.iter().all(|&id| id < 10));
        assert!(nearest_body_vertices(&garment, &frames).unwrap().iter().any(|&id| id >= 10));
    }

    #[test]
    fn cloth_in_a_fold_belongs_to_one_side() {
        // An armpit in the T-pose: the trunk's side faces x, the underside of the arm faces down.
        let side: Vec<Vec3> = (0..8).map(|i| Vec3::new(0.15, 0.02 * f64::from(i) - 0.16, 0.0)).collect();
        let arm: Vec<Vec3> = (0..8).map(|i| Vec3::new(0.16 + 0.02 * f64::from(i), 0.0, 0.0)).collect();
        let body: Vec<Vec3> = side.iter().chain(&arm).copied().collect();
        let normals: Vec<Vec3> = (0..16).map(|i| if i < 8 { Vec3::x() } else { -Vec3::y() }).collect();
        let shirt: Vec<Vec3> = body.iter().zip(&normals).map(|(p, n)| p + 0.005 * n).collect();
        // One joint moves both, as near an armpit.
        let weights = BlendWeights::from_rows((0..16).map(|_| vec![(0u16, 1.0)]));
        let map = ContactMap::new(&shirt, &weights, &body, &normals, 0.2).unwrap();
        // The arm comes down through the trunk's side.
        let mut posed = body.clone();
        for (i, p) in posed[8..].iter_mut().enumerate() {
            *p = shirt[i] + Vec3::new(0.001, 0.0, 0.0);
        }
        let mut garment = Frames::<f64>::zeros(1, 16, 1);
        garment.set_frame(0, 0, &shirt).unwrap();
        let mut frames = Frames::<f64>::zeros(1, 16, 1);
        frames.set_frame(0, 0, &posed).unwrap();
        let nearest = map.nearest(&garment, &frames).unwrap();
        for (v, ids) in nearest.chunks_exact(<f64 as Real>::LANES).enumerate() {
            assert_eq!(ids[0] < 8, v < 8, "cloth {v} meets skin {}", ids[0]);
        }
    }

    #[test]
    fn vertices_that_are_searched_together_have_skin_of_their_own() {
        // A strip of skin that faces down, cloth under all of it. Its far end is folded over to its beginning.
        let body: Vec<Vec3> = (0..20).map(|i| Vec3::new(0.02 * f64::from(i), 0.0, 0.0)).collect();
        let shirt: Vec<Vec3> = body.iter().map(|p| p - Vec3::new(0.0, 0.005, 0.0)).collect();
        let weights = BlendWeights::from_rows((0..20).map(|_| vec![(0u16, 1.0)]));
        let map = ContactMap::new(&shirt, &weights, &body, &[-Vec3::y(); 20], 0.05).unwrap();
        assert_eq!(map.regions.len(), 1);
        let mut posed = body.clone();
        for (i, p) in posed.iter_mut().enumerate().skip(15) {
            *p = shirt[19 - i] + Vec3::new(0.001, 0.0, 0.0);
        }
        let mut garment = Frames::<f64>::zeros(1, 20, 1);
        garment.set_frame(0, 0, &shirt).unwrap();
        let mut frames = Frames::<f64>::zeros(1, 20, 1);
        frames.set_frame(0, 0, &posed).unwrap();
        let nearest = map.nearest(&garment, &frames).unwrap();
        for (v, ids) in nearest.chunks_exact(<f64 as Real>::LANES).enumerate() {
            assert!((body[ids[0] as usize] - shirt[v]).norm() < 0.05, "cloth {v} meets skin {}", ids[0]);
            assert!(v > 12 || ids[0] as usize == v, "cloth {v} meets skin {}", ids[0]);
        }
    }

    impl Region {
        /// What a garment vertex can touch.
        fn touched(&self, k: usize) -> Vec<u32> {
            let groups = self.body.groups();
            self.body.named(&self.may[k * groups..][..groups]).collect()
        }
    }

    /// The simple version: a grid per garment vertex and frame.
    fn by_grids(map: &ContactMap, garment: &Frames<f32>, body: &Frames<f32>) -> Vec<u32> {
        let (n, width) = (garment.vertices(), <f32 as Real>::LANES);
        let mut out = vec![0; garment.blocks() * n * width];
        for block in 0..garment.blocks() {
            for lane in 0..garment.lanes_used() {
                let (cloth, skin) = (lane_points(garment, block, lane), lane_points(body, block, lane));
                for (region, k) in map.regions.iter().flat_map(|r| (0..r.garment.len()).map(move |k| (r, k))) {
                    let mut ids = region.touched(k);
                    ids.extend(map.body_count as u32..(map.body_count + map.obstacle_count) as u32);
                    ids.sort_unstable();
                    let grid = NearestGrid::new(&ids.iter().map(|&id| skin[id as usize]).collect::<Vec<_>>());
                    for &v in &region.garment[k..=k] {
                        let at = (block * n + v as usize) * width + lane;
                        out[at] = ids[grid.nearest(&cloth[v as usize]).unwrap().0 as usize];
                        if lane + 1 == garment.lanes_used() {
                            let found = out[at];
                            out[at..][..width - lane].fill(found);
                        }
                    }
                }
            }
        }
        out
    }

    #[test]
    fn it_equals_a_grid_per_vertex_and_frame_with_and_without_an_obstacle() {
        let wave = |i: usize, k: usize, f: usize| ((i * 7 + k * 13) as f64 * 0.37 + f as f64 * 0.3).sin();
        let skin = |f: usize| -> Vec<Vec3> { (0..400).map(|i| Vec3::from_fn(|k, _| 0.3 * wave(i, k, f))).collect() };
        let shirt = |f: usize| -> Vec<Vec3> {
            (0..90).map(|i| Vec3::from_fn(|k, _| 0.33 * wave(4 * i, k, f) + 0.01 * f as f64)).collect()
        };
        let weights = BlendWeights::from_rows((0..90).map(|i| vec![(i as u16 % 3, 1.0)]));
        for obstacles in [0, 70] {
            let map = ContactMap::new(&shirt(0), &weights, &skin(0), &[Vec3::z(); 400], 0.05)
                .unwrap()
                .with_obstacle(obstacles);
            assert!(map.regions.len() == 3 && map.regions.iter().all(|r| (20..400).contains(&r.body.ids().len())));
            for lanes in [1, 5, 16] {
                let mut garment = Frames::<f32>::zeros(2, 90, lanes);
                let mut body = Frames::<f32>::zeros(2, 400 + obstacles, lanes);
                for f in 0..2 * lanes {
                    garment.set_frame(f / lanes, f % lanes, &shirt(f)).unwrap();
                    let mut points = skin(f);
                    points.extend((0..obstacles).map(|i| Vec3::from_fn(|k, _| 0.35 * wave(i, k, 2 * f))));
                    body.set_frame(f / lanes, f % lanes, &points).unwrap();
                }
                assert_eq!(map.nearest(&garment, &body).unwrap(), by_grids(&map, &garment, &body));
            }
        }
    }

    #[test]
    fn without_limit_it_equals_the_search_among_all() {
        let (shirt, weights, body) = scene();
        let map = ContactMap::new(&shirt, &weights, &body, &vec![Vec3::z(); body.len()], 10.0).unwrap();
        let mut garment = Frames::<f32>::zeros(2, 10, 3);
        let mut frames = Frames::<f32>::zeros(2, 15, 3);
        for f in 0..6 {
            let shift = Vec3::new(0.02 * f as f64, 0.013 * f as f64, 0.0);
            garment.set_frame(f / 3, f % 3, &shirt.iter().map(|p| p + shift).collect::<Vec<_>>()).unwrap();
            frames.set_frame(f / 3, f % 3, &body).unwrap();
        }
        assert_eq!(map.nearest(&garment, &frames).unwrap(), nearest_body_vertices(&garment, &frames).unwrap());
        let bad = Frames::<f32>::zeros(2, 9, 3);
        assert!(map.nearest(&bad, &frames).is_err());
        garment.data_mut()[0] = f32::NAN;
        assert!(map.nearest(&garment, &frames).unwrap_err().to_string().contains("vertex 0"));
    }
}
