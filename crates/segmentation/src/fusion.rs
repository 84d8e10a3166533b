//! Labels on the scan's vertices from labels on its pictures (Sec. 3.1): render views, label pixels, vote.
//!
//! A vertex is seen in a view when one of its own triangles covers a pixel beside its projection, or when it lies on
//! the surface that its pixel shows: then its depth equals the depth of that surface *at the vertex's own position*,
//! found by continuing the pixel's triangle as a plane. Comparing with the plane instead of the pixel's depth takes the
//! surface's slope out of the tolerance, which can therefore be tight enough to tell skin from the cloth that lies on
//! it.

use crate::islands::without_islands;
use crate::unseen::fill;
use caphy_core::query::Adjacency;
use caphy_core::scan::{Label, Scan};
use caphy_core::segmenter::{Camera, Segmenter, View};
use caphy_core::{Error, Result, Vec3};
use caphy_render::raster::barycentric_unclamped;
use caphy_render::{Image, render, uniform_views};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How labels are fused.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FusionSettings {
    /// Number of views, uniformly distributed over the sphere of directions. 32: the paper's number.
    pub views: usize,
    /// Width and height of a view [pixels]. 512: about 4 mm per pixel on a standing person.
    pub size: usize,
    /// How far a vertex may lie behind the surface that its pixel shows and still be seen [pixels]. A quarter of a
    /// pixel: 1 mm at the default size, less than cloth keeps from skin, more than a smooth surface bends within a
    /// pixel.
    pub depth_tolerance: f64,
    /// Smallest |cosine| between a vertex's normal and the line of sight. 0.2: below it a pixel spans 5 pixels of
    /// surface, and a silhouette's labels belong to whatever is behind as often as not.
    pub min_facing: f64,
    /// Rounds of majority smoothing over edge neighbours after the vote. 1: takes single vertices out of noisy labels,
    /// moves a clean border by less than an edge.
    pub smoothing: usize,
    /// Patches of a label smaller than this take the label around them [m²]. 2 cm²: a crease as dark as hair, not the skin between sleeve and
    /// glove.
    pub smallest_patch: f64,
}

impl Default for FusionSettings {
    fn default() -> Self {
        Self { views: 32, size: 512, depth_tolerance: 0.25, min_facing: 0.2, smoothing: 1, smallest_patch: 2e-4 }
    }
}

impl FusionSettings {
    /// Checks the values.
    ///
    /// # Errors
    /// [`Error::Config`] naming the key.
    pub fn check(&self) -> Result<()> {
        let key = |name: &str| format!("fusion.{name}");
        if self.views == 0 {
            return Err(Error::config(key("views"), "is 0", "use at least 1; 32 is the paper's number"));
        }
        if !(16..=8192).contains(&self.size) {
            return Err(Error::config(key("size"), format!("is {}", self.size), "use 16 to 8192 pixels"));
        }
        if !(self.depth_tolerance > 0.0 && self.depth_tolerance.is_finite()) {
            let problem = format!("is {}", self.depth_tolerance);
            return Err(Error::config(
                key("depth_tolerance"),
                problem,
                "use a positive number of pixels; 0.25 is usual",
            ));
        }
        if !(0.0..1.0).contains(&self.min_facing) {
            let problem = format!("is {}", self.min_facing);
            return Err(Error::config(key("min_facing"), problem, "use a cosine from 0 to below 1; 0.2 is usual"));
        }
        if !(self.smallest_patch >= 0.0 && self.smallest_patch.is_finite()) {
            let problem = format!("is {}", self.smallest_patch);
            return Err(Error::config(key("smallest_patch"), problem, "use an area in m², 0 to keep all patches"));
        }
        Ok(())
    }
}

/// What the fusion found, for reports.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FusionReport {
    /// Number of vertices with each label of [`Label::ALL`], in that order.
    pub counts: [usize; 3],
    /// Share of all votes that went against the label that won at their vertex.
    pub disagreement: f64,
    /// Share of vertices that no view showed with a label.
    pub unseen: f64,
    /// Mean number of votes per seen vertex.
    pub votes_per_vertex: f64,
    /// Number of views.
    pub views: usize,
}

/// A label per vertex.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Fusion {
    /// Shape [vertex_count], never [`Label::Ignore`].
    pub labels: Vec<Label>,
    /// Whether a view showed the vertex with a label; the others' labels come from their neighbours. Shape
    /// [vertex_count].
    pub seen: Vec<bool>,
    /// Summary.
    pub report: FusionReport,
}

/// Labels every vertex of a scan by the majority of the views that show it (Sec. 3.1); ties go to the smaller label.
///
/// Vertices that no view shows take the label whose colours around them are theirs; where colours do not tell, those of the
/// nearest labelled vertices along edges, in components without any seen vertex that of the nearest seen vertex in space.
/// Deterministic on any number of threads.
///
/// # Errors
/// [`Error::Config`] for settings out of range; [`Error::Mesh`] for a scan without faces, with a broken mesh, or with
/// no vertex that any view shows with a label; the segmenter's own errors.
pub fn label_scan(scan: &Scan, segmenter: &dyn Segmenter, settings: &FusionSettings) -> Result<Fusion> {
    settings.check()?;
    scan.mesh.check(&scan.name)?;
    let Some(bounds) = scan.mesh.bounds().filter(|_| !scan.mesh.faces.is_empty()) else {
        let problem = format!("{} vertices and {} faces", scan.mesh.vertices.len(), scan.mesh.faces.len());
        return Err(Error::mesh(&scan.name, "surface", problem, "segmentation needs a triangulated scan"));
    };
    let cameras = uniform_views(bounds, settings.views, settings.size);
    let normals = scan.mesh.vertex_normals();
    // One vote (or Ignore) per vertex and view; views run in parallel, votes are counted in order.
    let ballots: Vec<Vec<Label>> = cameras
        .par_iter()
        .enumerate()
        .map(|(index, camera)| ballot(scan, &normals, segmenter, settings, index, camera))
        .collect::<Result<_>>()?;
    let vertex_count = scan.mesh.vertices.len();
    let mut labels = vec![Label::Ignore; vertex_count];
    let (mut total, mut against) = (0usize, 0usize);
    for (v, label) in labels.iter_mut().enumerate() {
        let mut votes = [0usize; 3];
        for ballot in &ballots {
            count(&mut votes, ballot[v]);
        }
        if let Some((winner, most)) = majority(&votes) {
            *label = winner;
            let cast: usize = votes.iter().sum();
            total += cast;
            against += cast - most;
        }
    }
    let seen: Vec<bool> = labels.iter().map(|l| *l != Label::Ignore).collect();
    let seen_count = seen.iter().filter(|s| **s).count();
    if seen_count == 0 {
        return Err(Error::mesh(
            &scan.name,
            "labels",
            format!("none of the {} views gave a label to any of the {vertex_count} vertices", settings.views),
            "check the segmenter's palette or labels against a picture of the scan",
        ));
    }
    let adjacency = Adjacency::new(vertex_count, &scan.mesh.faces);
    fill(scan, &adjacency, &seen, &mut labels);
    for _ in 0..settings.smoothing {
        labels = smoothed(&adjacency, &labels);
    }
    without_islands(&scan.mesh, &adjacency, &mut labels, settings.smallest_patch);
    let mut counts = [0; 3];
    labels.iter().for_each(|l| count(&mut counts, *l));
    let report = FusionReport {
        counts,
        disagreement: against as f64 / total as f64,
        unseen: 1.0 - seen_count as f64 / vertex_count as f64,
        votes_per_vertex: total as f64 / seen_count as f64,
        views: settings.views,
    };
    Ok(Fusion { labels, seen, report })
}

pub(crate) fn count(votes: &mut [usize; 3], label: Label) {
    if let Some(n) = votes.get_mut(label as usize) {
        *n += 1;
    }
}

/// The label with most votes (the smaller one of equals) and its votes; `None` without votes.
pub(crate) fn majority(votes: &[usize; 3]) -> Option<(Label, usize)> {
    let most = *votes.iter().max()?;
    let winner = Label::ALL.into_iter().find(|l| votes[*l as usize] == most)?;
    (most > 0).then_some((winner, most))
}

/// What one view says about each vertex, [`Label::Ignore`] where it does not show the vertex.
fn ballot(
    scan: &Scan,
    normals: &[Vec3],
    segmenter: &dyn Segmenter,
    settings: &FusionSettings,
    index: usize,
    camera: &Camera,
) -> Result<Vec<Label>> {
    let image = render(&scan.mesh, scan.colours.as_deref(), camera);
    let (colour, depth, triangle) = (&image.colour, &image.depth, &image.triangle);
    let view = View { scan, index, count: settings.views, camera, colour, depth, triangle };
    let mut pixels = vec![Label::Ignore; camera.width * camera.height];
    segmenter.segment(&view, &mut pixels)?;
    let sight: Vec3 = camera.world_to_camera.fixed_view::<1, 3>(2, 0).transpose();
    let tolerance = settings.depth_tolerance / camera.scale;
    let vote = |(v, normal): (usize, &Vec3)| {
        // Views are orthographic: one line of sight for all.
        if normal.dot(&sight).abs() < settings.min_facing {
            return Label::Ignore;
        }
        pixel_of(scan, v as u32, camera, &image, tolerance).map_or(Label::Ignore, |pixel| pixels[pixel])
    };
    Ok(normals.iter().enumerate().map(vote).collect())
}

/// The pixel that shows a vertex, if one does.
fn pixel_of(scan: &Scan, vertex: u32, camera: &Camera, image: &Image, tolerance: f64) -> Option<usize> {
    let (x, y, depth) = camera.project(&scan.mesh.vertices[vertex as usize]);
    if !(x >= 0.0 && y >= 0.0 && x < image.width as f64 && y < image.height as f64) {
        return None;
    }
    let (column, row) = (x as usize, y as usize);
    let home = row * image.width + column;
    let face_at = |pixel: usize| scan.mesh.faces.get(image.triangle[pixel] as usize);
    // The nearest pixel centre that one of the vertex's own triangles covers.
    let mut own: Option<(f64, usize)> = None;
    for j in row.saturating_sub(1)..=(row + 1).min(image.height - 1) {
        for i in column.saturating_sub(1)..=(column + 1).min(image.width - 1) {
            let pixel = j * image.width + i;
            if face_at(pixel).is_some_and(|f| f.contains(&vertex)) {
                let distance = (i as f64 + 0.5 - x).powi(2) + (j as f64 + 0.5 - y).powi(2);
                if own.is_none_or(|(best, _)| distance < best) {
                    own = Some((distance, pixel));
                }
            }
        }
    }
    if let Some((_, pixel)) = own {
        return Some(pixel);
    }
    // Triangles finer than pixels: the vertex must lie on the plane of what its pixel shows.
    let face = face_at(home)?;
    let corners = face.map(|id| {
        let (cx, cy, cz) = camera.project(&scan.mesh.vertices[id as usize]);
        // Pixels and depth: a camera of one pixel per unit.
        Vec3::new(cx, cy, cz)
    });
    let screen = Camera { scale: 1.0, perspective: false, ..camera.clone() };
    let middle = [0.5 * image.width as f64, 0.5 * image.height as f64];
    let shifted = corners.map(|c| Vec3::new(c.x - middle[0], c.y - middle[1], c.z));
    let weights = barycentric_unclamped(&shifted, [x, y], &screen);
    // Continued by more than its own size a triangle says nothing about its neighbourhood.
    let near = weights.iter().all(|w| (-4.0..=5.0).contains(w));
    let surface: f64 = (0..3).map(|k| weights[k] * corners[k].z).sum();
    (near && (depth - surface).abs() <= tolerance).then_some(home)
}

/// Each vertex takes the label that more than half of its neighbours share, if there is one.
fn smoothed(adjacency: &Adjacency, labels: &[Label]) -> Vec<Label> {
    (0..labels.len())
        .map(|v| {
            let mut votes = [0; 3];
            adjacency.of(v).iter().for_each(|&w| count(&mut votes, labels[w as usize]));
            match majority(&votes) {
                Some((label, most)) if 2 * most > adjacency.of(v).len() => label,
                _ => labels[v],
            }
        })
        .collect()
}
