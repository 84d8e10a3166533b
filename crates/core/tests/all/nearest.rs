//! Nearest vertices and surface points against brute force and against an independent crate (parry3d), on clouds and meshes
//! with duplicates, slivers, specks and far queries.

use caphy_core::lanes::Frames;
use caphy_core::query::{
    Asked, LaneAnswers, NearestGrid, NearestInLanes, NearestSurface, PseudoNormals, SurfacePoint, TriangleFeature,
    nearest_on_line, nearest_on_triangle,
};
use caphy_core::{Error, Real, TriMesh, Vec3};
use parry3d_f64::math::Vector;
use parry3d_f64::query::PointQuery;
use parry3d_f64::shape::{Polyline, TriMesh as ParryMesh};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn random(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

/// Uniform in a cube around the origin.
fn point(rng: &mut ChaCha8Rng, half: f64) -> Vec3 {
    Vec3::from_fn(|_, _| (2.0 * rng.random::<f64>() - 1.0) * half)
}

fn parry(p: &Vec3) -> Vector {
    Vector::new(p.x, p.y, p.z)
}

/// A bumpy closed surface: an octahedron, split `splits` times and pushed onto a star shape of radius about 1.
fn bumpy(splits: usize) -> TriMesh {
    let vertices = [Vec3::x(), Vec3::y(), Vec3::z(), -Vec3::x(), -Vec3::y(), -Vec3::z()].to_vec();
    let faces = vec![[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]];
    let mut mesh = TriMesh { vertices, faces };
    for _ in 0..splits {
        mesh = mesh.subdivided();
        mesh.vertices.iter_mut().for_each(|v| *v = v.normalize());
    }
    for v in &mut mesh.vertices {
        *v *= 1.0 + 0.25 * (4.0 * v.x).sin() * (5.0 * v.y).cos() + 0.1 * (9.0 * v.z).sin();
    }
    mesh
}

/// Near the surface, inside, around, and far away.
fn queries(rng: &mut ChaCha8Rng, mesh: &TriMesh, count: usize) -> Vec<Vec3> {
    (0..count)
        .map(|i| match i % 5 {
            0 => mesh.vertices[rng.random_range(0..mesh.vertices.len())] + point(rng, 0.01),
            1 => point(rng, 0.5),
            2 => point(rng, 2.0),
            3 => point(rng, 30.0),
            _ => point(rng, 1e6),
        })
        .collect()
}

/// Rounding of a distance [m] between two points of this size.
fn rounding(query: &Vec3) -> f64 {
    16.0 * f64::EPSILON * (query.amax() + 2.0)
}

fn brute_surface(mesh: &TriMesh, q: &Vec3) -> (u32, f64) {
    (0..mesh.faces.len())
        .map(|f| (f as u32, nearest_on_triangle(q, &mesh.corners(f)).squared_distance))
        .fold((u32::MAX, f64::INFINITY), |best, next| if next.1 < best.1 { next } else { best })
}

/// What every answer must be: a point of the triangle that it names, with weights that say so.
fn check_answer(mesh: &TriMesh, q: &Vec3, found: &SurfacePoint) {
    let corners = mesh.corners(found.face as usize);
    let mixed: Vec3 = corners.iter().zip(found.barycentric).map(|(c, w)| c * w).sum();
    assert!((mixed - found.point).norm() < 1e-15 * (1.0 + mixed.norm()), "{found:?}");
    let sum: f64 = found.barycentric.iter().sum();
    assert!((sum - 1.0).abs() < 4.0 * f64::EPSILON && found.barycentric.iter().all(|&w| w >= 0.0), "{found:?}");
    assert!(((q - found.point).norm() - found.squared_distance.sqrt()).abs() < rounding(q));
    let zeros = found.barycentric.iter().filter(|&&w| w == 0.0).count();
    match found.feature {
        TriangleFeature::Corner(k) => assert_eq!(found.barycentric[k as usize], 1.0),
        TriangleFeature::Side(k) => assert_eq!(found.barycentric[(k as usize + 2) % 3], 0.0),
        TriangleFeature::Inside => assert_eq!(zeros, 0),
    }
}

#[test]
fn nearest_vertices_equal_brute_force_to_the_bit_in_both_precisions() {
    let mut rng = random(1);
    let mut mesh = bumpy(4);
    // Duplicates: the smallest id must win.
    let copies: Vec<Vec3> = mesh.vertices.iter().step_by(3).copied().collect();
    mesh.vertices.extend(copies);
    let clouds = [
        mesh.vertices.clone(),
        (0..700).map(|_| point(&mut rng, 1.0)).collect(),
        // On a line, in a plane, all in one place, one far from all others.
        (0..300).map(|i| Vec3::new(f64::from(i) * 0.01, 0.0, 0.0)).collect(),
        (0..900).map(|i| Vec3::new(f64::from(i % 30), 2.0, f64::from(i / 30)) * 0.1).collect(),
        vec![Vec3::new(0.3, -0.2, 0.1); 50],
        (0..400).map(|i| if i == 200 { Vec3::repeat(1e4) } else { point(&mut rng, 1e-3) }).collect(),
        // Far from the origin: cells are small against coordinates.
        (0..400).map(|_| Vec3::repeat(1e5) + point(&mut rng, 0.5)).collect(),
        vec![Vec3::x()],
    ];
    for (number, cloud) in clouds.iter().enumerate() {
        let mut asked = queries(&mut rng, &mesh, 400);
        asked.extend(cloud.iter().step_by(7).copied());
        asked.extend(cloud.iter().step_by(11).map(|p| p + point(&mut rng, 0.1)));
        let double: Vec<[f64; 3]> = cloud.iter().map(|&p| p.into()).collect();
        let single: Vec<[f32; 3]> = cloud.iter().map(|p| [p.x as f32, p.y as f32, p.z as f32]).collect();
        let (grid, grid_single) = (NearestGrid::new(&double), NearestGrid::new(&single));
        for q in &asked {
            macro_rules! brute {
                ($points:expr, $q:expr) => {
                    $points.iter().enumerate().fold((u32::MAX, 1.0 / 0.0), |best, (i, p)| {
                        let (x, y, z) = (p[0] - $q[0], p[1] - $q[1], p[2] - $q[2]);
                        let d = x * x + y * y + z * z;
                        if d < best.1 { (i as u32, d) } else { best }
                    })
                };
            }
            let (d, s) = ([q.x, q.y, q.z], [q.x as f32, q.y as f32, q.z as f32]);
            let (wanted, wanted_single) = (brute!(double, d), brute!(single, s));
            assert_eq!(grid.nearest(&d).unwrap(), wanted, "cloud {number}, {q}");
            assert_eq!(grid_single.nearest(&s).unwrap(), wanted_single, "cloud {number}, {q}");
            // From any earlier answer, good, bad or none, the same bits.
            for known in [wanted.0, 0, cloud.len() as u32 / 2, cloud.len() as u32, u32::MAX] {
                assert_eq!(grid.nearest_from(&d, known).unwrap(), wanted, "cloud {number}, {q} from {known}");
                assert_eq!(grid_single.nearest_from(&s, known).unwrap(), wanted_single);
            }
            // A limit is strict.
            assert_eq!(grid.nearest_within(&d, wanted.1), None);
            assert_eq!(grid.nearest_within(&d, wanted.1 * 1.000001 + 1e-300), Some(wanted));
        }
    }
}

/// Frames of points that bend, turn and drift apart with their lane, and queries around them.
fn lanes_of<T: Real>(cloud: &[Vec3], asked: &[Vec3], used: usize) -> (Frames<T>, Frames<T>) {
    let mut points = Frames::zeros(1, cloud.len(), used);
    let mut queries = Frames::zeros(1, asked.len(), used);
    for lane in 0..used {
        let bend = 0.2 * lane as f64;
        let moved = |p: &Vec3| Vec3::new(p.x + bend * p.y, p.y - bend * p.x * p.x.clamp(-1.0, 1.0), p.z + bend);
        points.set_frame(0, lane, &cloud.iter().map(moved).collect::<Vec<_>>()).unwrap();
        queries.set_frame(0, lane, &asked.iter().map(moved).collect::<Vec<_>>()).unwrap();
    }
    (points, queries)
}

fn lane<T: Real>(frames: &Frames<T>, lane: usize) -> Vec<[T; 3]> {
    frames.data().chunks_exact(3 * T::LANES).map(|p| [0, 1, 2].map(|k| p[k * T::LANES + lane])).collect()
}

/// Searches in lanes and, frame by frame, in grids; `ids` are the points that count, grouped as `grouped` lie.
fn lanes_equal_grids<T: Real>(points: &Frames<T>, queries: &Frames<T>, grouped: &[Vec3], ids: &[u32]) {
    let search = NearestInLanes::new(grouped, ids);
    let boxes = search.boxes(points.data());
    let asked: Vec<u32> = (0..queries.vertices() as u32).rev().collect();
    // Everything may answer, or for each query another part; the second query nothing.
    let some = |v: u32, id: u32| v != 1 && (id.wrapping_mul(2_654_435_761) ^ v).is_multiple_of(3);
    let masks: Vec<u8> = asked.iter().flat_map(|&v| search.mask(|id| some(v, id))).collect();
    for (v, mask) in asked.iter().zip(masks.chunks(search.groups().max(1))) {
        let mut named: Vec<u32> = search.named(mask).collect();
        named.sort_unstable();
        assert_eq!(named, ids.iter().copied().filter(|&id| some(*v, id)).collect::<Vec<_>>());
    }
    for masked in [false, true] {
        let may = |v: u32, id: u32| !masked || some(v, id);
        // From a good group, from a bad one, and from none.
        let begin = |&v: &u32| search.home(grouped, &queries.get(0, 0, v as usize), |id| may(v, id));
        let near: Vec<u32> = asked.iter().map(begin).collect();
        let bad: Vec<u32> = asked.iter().map(|&v| v % search.groups() as u32).collect();
        for home in [Some(&near[..]), Some(&bad), None] {
            let mut answers = LaneAnswers::none(asked.len());
            let of = Asked { rows: &asked, home, may: masked.then_some(&masks[..]) };
            search.search(points.data(), &boxes, queries.data(), of, &mut answers);
            for l in 0..T::LANES {
                let all = lane(points, l);
                for (i, &v) in asked.iter().enumerate() {
                    let ids: Vec<u32> = ids.iter().copied().filter(|&id| may(v, id)).collect();
                    let grid = NearestGrid::new(&ids.iter().map(|&id| all[id as usize]).collect::<Vec<_>>());
                    let query = lane(queries, l)[v as usize];
                    let wanted = grid.nearest(&query).map_or((u32::MAX, T::infinity()), |(k, d)| (ids[k as usize], d));
                    let at = i * T::LANES + l;
                    assert_eq!((answers.ids[at], answers.squares[at]), wanted, "lane {l}, query {i} at {query:?}");
                }
            }
        }
    }
}

#[test]
fn lanes_give_the_bits_of_a_grid_per_frame() {
    let mut rng = random(7);
    let mut mesh = bumpy(3);
    let copies: Vec<Vec3> = mesh.vertices.iter().step_by(3).copied().collect();
    mesh.vertices.extend(copies);
    let cloud: Vec<Vec3> = (0..300).map(|_| point(&mut rng, 1.0)).collect();
    let flat: Vec<Vec3> = (0..225).map(|i| Vec3::new(f64::from(i % 15), 2.0, f64::from(i / 15)) * 0.125).collect();
    for cloud in [&mesh.vertices[..], &cloud, &flat, &cloud[..9], &cloud[..8], &cloud[..1]] {
        // Queries in the middle of a lattice are as far from several points to the bit.
        let mut asked: Vec<Vec3> = cloud.iter().take(20).map(|p| p + Vec3::new(0.0625, 0.01, 0.0625)).collect();
        asked.extend(queries(&mut rng, &mesh, 40));
        let all: Vec<u32> = (0..cloud.len() as u32).collect();
        let some: Vec<u32> = all.iter().copied().step_by(2).collect();
        // Groups of a pose that has nothing to do with the frames: slow, and the same answers.
        let unlike: Vec<Vec3> = cloud.iter().map(|_| point(&mut rng, 1.0)).collect();
        for (used, ids, grouped) in [(16, &all, cloud), (5, &some, cloud), (1, &all, &unlike[..])] {
            let (points, queries) = lanes_of::<f32>(cloud, &asked, used);
            lanes_equal_grids(&points, &queries, grouped, ids);
            let (points, queries) = lanes_of::<f64>(cloud, &asked, used.min(8));
            lanes_equal_grids(&points, &queries, grouped, ids);
        }
    }
}

#[test]
fn lanes_without_an_answer_say_so_and_the_others_have_theirs() {
    let cloud = bumpy(2).vertices;
    let ids: Vec<u32> = (0..cloud.len() as u32).collect();
    let (mut points, mut queries) = lanes_of::<f32>(&cloud, &cloud[..4], 16);
    // A point that is nowhere, a lane without any, queries that are nowhere.
    points.data_mut()[3] = f32::NAN;
    points.data_mut()[16 + 4] = f32::INFINITY;
    points.data_mut().chunks_exact_mut(16).for_each(|row| row[5] = f32::NAN);
    queries.data_mut()[6] = f32::NAN;
    queries.data_mut()[7] = f32::INFINITY;
    lanes_equal_grids(&points, &queries, &cloud, &ids);
    let search = NearestInLanes::new(&cloud, &[]);
    let mut answers = LaneAnswers::none(4);
    let asked = Asked { rows: &[0, 1, 2, 3], home: None, may: None };
    search.search(points.data(), &search.boxes(points.data()), queries.data(), asked, &mut answers);
    assert_eq!(answers, LaneAnswers::none(4));
    assert_eq!((search.groups(), search.home(&cloud, &Vec3::zeros(), |_| true)), (0, 0));
}

#[test]
fn nearest_vertices_agree_with_an_independent_search() {
    let mut rng = random(2);
    let mesh = bumpy(4);
    let points: Vec<Vector> = mesh.vertices.iter().map(parry).collect();
    // A polyline of segments without length is a cloud.
    let cloud = Polyline::new(points, Some((0..mesh.vertices.len() as u32).map(|i| [i, i]).collect()));
    let grid = NearestGrid::from_points(&mesh.vertices);
    for q in queries(&mut rng, &mesh, 2000) {
        let (_, d) = grid.nearest_point(&q).unwrap();
        let other = cloud.distance_to_local_point(parry(&q), false);
        assert!((d.sqrt() - other).abs() < rounding(&q), "{q}: {} {other}", d.sqrt());
    }
}

#[test]
fn nearest_surface_points_equal_brute_force_and_an_independent_search() {
    let mut rng = random(3);
    let mesh = bumpy(4);
    let surface = NearestSurface::from_mesh(&mesh).unwrap();
    let oracle = ParryMesh::new(mesh.vertices.iter().map(parry).collect(), mesh.faces.clone()).unwrap();
    let asked = queries(&mut rng, &mesh, 2000);
    for q in &asked {
        let found = surface.nearest(q).unwrap();
        check_answer(&mesh, q, &found);
        assert_eq!((found.face, found.squared_distance), brute_surface(&mesh, q), "{q}");
        let other = oracle.distance_to_local_point(parry(q), false);
        assert!((found.squared_distance.sqrt() - other).abs() < rounding(q), "{q}: {found:?}, {other}");
        for known in [found.face, 0, 700, u32::MAX] {
            assert_eq!(surface.nearest_from(q, known).unwrap(), found);
        }
        assert_eq!(surface.nearest_within(q, found.squared_distance), None);
        assert_eq!(surface.nearest_within(q, found.squared_distance * 1.000001), Some(found));
    }
    // On the surface itself the distance is rounding.
    for f in (0..mesh.faces.len()).step_by(17) {
        let [a, b, c] = mesh.corners(f);
        let found = surface.nearest(&(a * 0.2 + b * 0.3 + c * 0.5)).unwrap();
        assert!(found.squared_distance.sqrt() < 1e-15, "{found:?}");
    }
}

/// Meshes that no scanner should write and some do.
fn broken_meshes(rng: &mut ChaCha8Rng) -> Vec<TriMesh> {
    let soup = |rng: &mut ChaCha8Rng, count: usize, make: &dyn Fn(&mut ChaCha8Rng, usize) -> [Vec3; 3]| {
        let vertices: Vec<Vec3> = (0..count).flat_map(|i| make(rng, i)).collect();
        TriMesh { vertices, faces: (0..count as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect() }
    };
    let around = |rng: &mut ChaCha8Rng, size: f64| {
        let p = point(rng, 1.0);
        [p, p + point(rng, size), p + point(rng, size)]
    };
    vec![
        // Sizes over five decades.
        soup(rng, 300, &|rng, i| around(rng, 10f64.powi(-((i % 6) as i32)))),
        // Slivers of every height, down to lines.
        soup(rng, 400, &|rng, i| {
            let [a, b, c] = around(rng, 0.5);
            let height = if i % 20 == 0 { 0.0 } else { 10f64.powi(-((i % 18) as i32)) };
            [a, b, a + (b - a) * 0.3 + (c - a) * height]
        }),
        // Points, lines with a doubled end, and lines with the third corner beyond.
        soup(rng, 300, &|rng, i| {
            let [a, b, _] = around(rng, 0.5);
            [[a, a, a], [a, b, a], [a, a, b], [b, a, a], [a, b, a + (b - a) * 1.5]][i % 5]
        }),
        // The same triangle many times.
        soup(rng, 40, &|_, _| [Vec3::x(), Vec3::y(), Vec3::z()]),
        // One large triangle among many small ones.
        soup(rng, 300, &|rng, i| match i {
            0 => [Vec3::repeat(-50.0), Vec3::new(50.0, -50.0, 0.0), Vec3::repeat(50.0)],
            _ => around(rng, 0.01),
        }),
        // All in a plane that is one of the grid's faces.
        soup(rng, 300, &|rng, _| around(rng, 0.2).map(|p| Vec3::new(p.x, 0.5, p.z))),
    ]
}

/// Distance to a triangle by another way: a dense walk over it is replaced by minimising along each side and over the
/// plane in extended steps (golden section twice), good to about 1e-8 of its size.
fn by_search(q: &Vec3, [a, b, c]: &[Vec3; 3]) -> f64 {
    let golden = |f: &dyn Fn(f64) -> f64| {
        let (mut lo, mut hi) = (0.0, 1.0);
        let ratio = (5f64.sqrt() - 1.0) / 2.0;
        for _ in 0..80 {
            let (l, r) = (hi - ratio * (hi - lo), lo + ratio * (hi - lo));
            if f(l) < f(r) { hi = r } else { lo = l }
        }
        f(0.5 * (lo + hi))
    };
    // Distance is convex over the triangle, and so is its minimum along a line that sweeps over it.
    golden(&|s| golden(&|t| (a + (b - a) * s + (c - b) * (s * t) - q).norm()))
}

#[test]
fn slivers_specks_and_duplicates_are_exact_too() {
    let mut rng = random(4);
    for (number, mesh) in broken_meshes(&mut rng).iter().enumerate() {
        let surface = NearestSurface::from_mesh(mesh).unwrap();
        for q in queries(&mut rng, mesh, 300) {
            let found = surface.nearest(&q).unwrap();
            check_answer(mesh, &q, &found);
            assert_eq!((found.face, found.squared_distance), brute_surface(mesh, &q), "mesh {number}, {q}");
            assert_eq!(surface.nearest_from(&q, mesh.faces.len() as u32 / 2).unwrap(), found);
        }
        // One triangle at a time against a search that knows no regions. Golden sections resolve the root of the machine's
        // precision of a parameter.
        for f in (0..mesh.faces.len()).step_by(7) {
            let corners = mesh.corners(f);
            let size = (corners[1] - corners[0]).norm() + (corners[2] - corners[0]).norm();
            let inside = (corners[0] + corners[1] + corners[2]) / 3.0;
            for q in [point(&mut rng, 1.0), inside + point(&mut rng, 1e-3), inside] {
                let (got, wanted) =
                    (nearest_on_triangle(&q, &corners).squared_distance.sqrt(), by_search(&q, &corners));
                assert!((got - wanted).abs() < 1e-7 * size + 1e-12, "mesh {number}, face {f}: {got} {wanted}");
                // The regions of a triangle a hundred times as long as high lose four of sixteen digits.
                let lost = 4.0 * f64::EPSILON * 1e4;
                assert!(got <= wanted + lost * (size + q.norm()), "mesh {number}, face {f}: {got} {wanted}");
            }
        }
    }
}

#[test]
fn nearest_points_of_lines_are_those_of_triangles_without_area() {
    let mut rng = random(7);
    for _ in 0..1000 {
        let [p, a, b] = [(); 3].map(|()| point(&mut rng, 1.0));
        let wanted = nearest_on_triangle(&p, &[a, b, b]).point;
        assert!((nearest_on_line(&p, [&a, &b]) - wanted).norm() < 1e-12, "{p} {a} {b}");
    }
    let at = Vec3::new(0.1, 0.2, 0.3);
    assert_eq!(nearest_on_line(&Vec3::zeros(), [&at, &at]), at);
}

#[test]
fn the_side_is_right_also_nearest_to_edges_and_corners() {
    let mut rng = random(5);
    // Sharp: most outer points are nearest to an edge or a corner.
    let spiky = {
        let mut mesh = bumpy(1);
        mesh.vertices.iter_mut().enumerate().for_each(|(i, v)| *v *= if i % 3 == 0 { 1.6 } else { 0.7 });
        mesh
    };
    for mesh in [spiky, bumpy(3)] {
        let surface = NearestSurface::from_mesh(&mesh).unwrap();
        let normals = PseudoNormals::new(&mesh.vertices, &mesh.faces);
        let mut seen = [0usize; 3];
        for _ in 0..3000 {
            let q = point(&mut rng, 1.8);
            let found = surface.nearest(&q).unwrap();
            seen[match found.feature {
                TriangleFeature::Inside => 0,
                TriangleFeature::Side(_) => 1,
                TriangleFeature::Corner(_) => 2,
            }] += 1;
            // Inside by the solid angle of all triangles (van Oosterom, Strackee 1983): 4π or 0.
            let angle: f64 = (0..mesh.faces.len())
                .map(|f| {
                    let [a, b, c] = mesh.corners(f).map(|p| p - q);
                    let (x, y, z) = (a.norm(), b.norm(), c.norm());
                    let below = x * y * z + a.dot(&b) * z + b.dot(&c) * x + c.dot(&a) * y;
                    2.0 * a.dot(&b.cross(&c)).atan2(below)
                })
                .sum();
            let inside = angle.abs() > std::f64::consts::TAU;
            let signed = normals.signed_distance(&q, &found);
            assert_eq!(signed < 0.0, inside, "{q}: {found:?}, solid angle {angle}");
            assert_eq!(signed.abs(), found.squared_distance.sqrt());
        }
        assert!(seen.iter().all(|&n| n > 30), "{seen:?}");
    }
}

#[test]
fn bad_input_is_an_error_or_no_answer() {
    let grid = NearestGrid::new(&[[0.0f32, f32::NAN, 0.0], [1.0, 1.0, 1.0]]);
    assert_eq!(grid.nearest(&[0.0; 3]), Some((1, 3.0)));
    assert_eq!(grid.nearest_from(&[0.0; 3], 0), Some((1, 3.0)));
    assert_eq!(grid.nearest(&[f32::NAN, 0.0, 0.0]), None);
    assert_eq!(grid.nearest_from(&[f32::INFINITY, 0.0, 0.0], 1), None);
    let empty = NearestGrid::<f64>::new(&[]);
    assert!(empty.is_empty() && empty.nearest(&[0.0; 3]).is_none() && empty.nearest_from(&[0.0; 3], 0).is_none());
    let text = empty.nearest_all(&[[0.0; 3]], None).unwrap_err().to_string();
    assert!(text.contains("points to search"), "{text}");
    let error = grid.nearest_all(&[[0.0; 3], [0.0, f32::NAN, 0.0]], None).unwrap_err();
    assert!(matches!(&error, Error::NonFinite { what, index: 1, .. } if what == "query 1"), "{error}");
    assert!(matches!(grid.nearest_all(&[[0.0; 3]], Some(&[])), Err(Error::Length { .. })));
    assert_eq!(grid.nearest_all(&[], None).unwrap(), []);

    let mesh = bumpy(1);
    let surface = NearestSurface::from_mesh(&mesh).unwrap();
    assert!(surface.nearest(&Vec3::new(0.0, f64::NAN, 0.0)).is_none());
    assert!(surface.nearest_from(&Vec3::repeat(f64::INFINITY), 3).is_none());
    let error = surface.nearest_all(&[Vec3::x(), Vec3::repeat(f64::NAN)], None).unwrap_err();
    assert!(matches!(&error, Error::NonFinite { what, .. } if what == "query 1"), "{error}");
    let none = NearestSurface::new(&[], &[]).unwrap();
    assert!(none.is_empty() && none.nearest(&Vec3::x()).is_none());
    assert!(matches!(none.nearest_all(&[Vec3::x()], None), Err(Error::Mesh { .. })));
    let text = NearestSurface::new(&mesh.vertices, &[[0, 1, 2], [0, 1, 99]]).unwrap_err().to_string();
    assert!(text.contains("face 1") && text.contains("99"), "{text}");
    let text =
        NearestSurface::new(&[Vec3::x(), Vec3::y(), Vec3::repeat(f64::NAN)], &[[0, 1, 2]]).unwrap_err().to_string();
    assert!(text.contains("face 0") && text.contains("vertex 2"), "{text}");
    // A vertex that no face names may be anything.
    assert!(NearestSurface::new(&[Vec3::x(), Vec3::y(), Vec3::z(), Vec3::repeat(f64::NAN)], &[[0, 1, 2]]).is_ok());
}

#[test]
fn batches_give_the_bits_of_single_queries_whatever_helps_them() {
    let mut rng = random(6);
    let mesh = bumpy(4);
    let asked = queries(&mut rng, &mesh, 1500);
    let surface = NearestSurface::from_mesh(&mesh).unwrap();
    let wanted: Vec<SurfacePoint> = asked.iter().map(|q| surface.nearest(q).unwrap()).collect();
    let arrays: Vec<[f64; 3]> = asked.iter().map(|&q| q.into()).collect();
    let grid = NearestGrid::from_points(&mesh.vertices);
    let wanted_vertices: Vec<(u32, f64)> = arrays.iter().map(|q| grid.nearest(q).unwrap()).collect();
    let known: Vec<u32> = (0..asked.len()).map(|_| rng.random_range(0..1000)).collect();
    let all = || {
        for known in [None, Some(&known[..])] {
            assert_eq!(surface.nearest_all(&asked, known).unwrap(), wanted);
            assert_eq!(grid.nearest_all(&arrays, known).unwrap(), wanted_vertices);
        }
    };
    all();
    #[cfg(feature = "threads")]
    for threads in [1, 2, 3, 8] {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(all);
    }
    #[cfg(not(feature = "threads"))]
    println!("SKIPPED: numbers of threads, without the feature `threads`");
}
