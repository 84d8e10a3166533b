//! Labels a PLY scan and writes pictures of it: `cargo run --release -p caphy-segmentation --example label_scan --
//! scan.ply out.png`.
//!
//! Prints the time of rendering, labelling and voting over 32 views of 512² pixels. Scans without labels are only
//! drawn.

use caphy_core::Vec3;
use caphy_formats::ply::read_ply;
use caphy_render::{Layer, Picture, Projection, Rgb, contact_sheet, frame, png, render, uniform_views};
use caphy_segmentation::{FusionSettings, SegmenterVertex, label_picture, label_scan};
use std::path::PathBuf;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1).map(PathBuf::from);
    let (Some(input), Some(output)) = (arguments.next(), arguments.next()) else {
        return Err("give a PLY scan and the PNG to write".into());
    };
    let scan = read_ply(&input, &std::fs::read(&input)?)?;
    let bounds = scan.mesh.bounds().ok_or("the scan has no vertices")?;
    let views = uniform_views(bounds, 32, 512);
    let mut fastest = f64::INFINITY;
    for camera in &views {
        let start = Instant::now();
        std::hint::black_box(render(&scan.mesh, scan.colours.as_deref(), camera));
        fastest = fastest.min(start.elapsed().as_secs_f64());
    }
    println!("{} triangles, render: {:.1} ms for the fastest view", scan.mesh.faces.len(), 1e3 * fastest);
    let white = vec![[205; 3]; scan.mesh.vertices.len()];
    let colours = scan.colours.as_deref().unwrap_or(&white);
    let mut pictures: Vec<(String, Rgb)> = Vec::new();
    let sides = [("front", Vec3::new(0.25, 0.2, 1.0)), ("back", Vec3::new(-0.3, 0.2, -1.0))];
    let fusion = if scan.labels.is_some() {
        let start = Instant::now();
        let fusion = label_scan(&scan, &SegmenterVertex, &FusionSettings::default())?;
        println!("fusion of 32 views: {:.2} s; {:?}", start.elapsed().as_secs_f64(), fusion.report);
        Some(fusion)
    } else {
        None
    };
    for (side, from) in sides {
        let camera = frame(bounds, &from, Projection::Perspective { field_of_view: 0.5 }, 440, 560);
        let start = Instant::now();
        let picture = Picture::new(camera.clone(), vec![Layer::per_vertex(&scan.mesh, colours)]);
        pictures.push((format!("{} {side}", scan.name), picture.with_ground(bounds.0.y).draw()));
        println!("picture: {:.0} ms", 1e3 * start.elapsed().as_secs_f64());
        if let Some(fusion) = &fusion {
            pictures.push((format!("labels {side}"), label_picture(&scan, &fusion.labels, &camera)?));
            let seen: Vec<_> = fusion.seen.iter().map(|s| if *s { [205; 3] } else { [200, 60, 50] }).collect();
            pictures.push((
                format!("unseen {side}"),
                Picture::new(camera, vec![Layer::per_vertex(&scan.mesh, &seen)]).draw(),
            ));
        }
    }
    let camera = &views[14];
    let view = render(&scan.mesh, Some(colours), camera);
    pictures.push(("view 14".into(), Rgb::from_view(&view, [255; 3])));
    let named: Vec<(&str, &Rgb)> = pictures.iter().map(|(name, picture)| (name.as_str(), picture)).collect();
    std::fs::write(&output, png(&contact_sheet(&named, 4))?)?;
    Ok(())
}
