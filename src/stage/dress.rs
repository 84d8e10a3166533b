//! A subject without scans: a body of a given shape in given garments.

use super::Context;
use super::preprocess::Subject;
use crate::config::DressedConfig;
use crate::garment::FittedGarment;
use crate::pictures;
use caphy_core::{Error, Result, TriMesh};
use caphy_garment::template::{BodyRest, GarmentKind, GivenStyle, Style, Tailor, TemplateSource};

/// Dresses the body.
pub fn run(context: &Context<'_>, dressed: &DressedConfig) -> Result<Subject> {
    let body = context.config.body.body(context.files)?;
    let subject = body.rest(&dressed.shape);
    let rest = BodyRest::from_model(&*body, &subject)?;
    let surface = rest.mesh.clone();
    let tailor = Tailor::new(rest)?;
    let mut garments = Vec::new();
    for (k, (kind, key, settings)) in context.config.garments().enumerate() {
        context.progress.set(0.5 * k as f64, &format!("{kind} template"));
        let source = settings.template.template(context.files)?;
        let style = style(&*source, &tailor, kind, key, settings.style.as_deref())?;
        let template = source.template(&tailor, &style, settings.resolution_m)?;
        let weights = &body.describe().weights;
        garments.push(
            FittedGarment::new(template, &surface.vertices, weights, &settings.weights)?.weighing(settings.mass_g),
        );
    }
    let rest = TriMesh { vertices: surface.vertices, faces: body.describe().faces.clone() };
    let meshes: Vec<TriMesh> = garments.iter().map(|g| g.mesh.clone()).collect();
    let worn = pictures::Dressed { body: &rest, garments: meshes };
    let sides = [("templates", pictures::FRONT), ("from behind", pictures::BACK)]
        .map(|(label, from)| (label.to_string(), pictures::dressed(&worn, &from)));
    context.write("pictures/templates.png", &pictures::sheet(&sides, 2)?)?;
    Ok(Subject {
        shape: dressed.shape.clone(),
        displacement: Vec::new(),
        scans: Vec::new(),
        skipped: Vec::new(),
        garments,
        choices: Vec::new(),
        pictures: vec!["pictures/templates.png".into()],
    })
}

/// The style that the configuration names, or what a source says without one.
fn style(
    source: &dyn TemplateSource,
    tailor: &Tailor,
    kind: GarmentKind,
    key: &str,
    values: Option<&[f64]>,
) -> Result<Style> {
    let mut styles = source.styles(tailor, kind, 1, 0)?;
    let first = match styles.pop() {
        Some(style) if styles.is_empty() => style,
        _ => {
            let problem = format!("holds {} garments", styles.len());
            return Err(Error::config(format!("{key}.template"), problem, "name one of its files"));
        }
    };
    match (first, values) {
        (Style::Given(given), None) => Ok(Style::Given(given)),
        (Style::Given(GivenStyle { garment, name, coefficients }), Some(values)) => {
            if coefficients.is_empty() {
                let remedy = "leave it out";
                return Err(Error::config(format!("{key}.style"), "the template has no style to choose", remedy));
            }
            Ok(Style::Given(GivenStyle { garment, name, coefficients: values.to_vec() }))
        }
        // The parametric space: its middle, or a point of it.
        (_, None) => Style::from_unit(kind, &vec![0.5; kind.ranges().len()]),
        (_, Some(values)) => Style::from_values(kind, values),
    }
}
