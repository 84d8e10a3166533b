//! Many queries at once, in threads where the feature `threads` is on.

use super::surface::{NearestSurface, SurfacePoint};
use super::vertices::NearestGrid;
use crate::{Error, Real, Result, Vec3};
#[cfg(feature = "threads")]
use rayon::prelude::*;

/// Queries that one thread answers in a row, each helped by the answer before.
const CHUNK: usize = 256;

/// Answers queries in chunks. `answer(i, known)` is given the id of an earlier answer and returns an id with its answer.
fn in_chunks<A: Send>(
    count: usize,
    known: Option<&[u32]>,
    answer: impl Fn(usize, Option<u32>) -> Result<(u32, A)> + Sync,
) -> Result<Vec<A>> {
    if let Some(known) = known {
        Error::check_length("known answers, one per query", count, known.len())?;
    }
    let chunk = |start: usize| -> Result<Vec<A>> {
        let mut last = None;
        (start..(start + CHUNK).min(count))
            .map(|i| {
                let (id, found) = answer(i, known.map(|k| k[i]).or(last))?;
                last = Some(id);
                Ok(found)
            })
            .collect()
    };
    let chunks = count.div_ceil(CHUNK);
    #[cfg(feature = "threads")]
    let parts: Vec<Result<Vec<A>>> = (0..chunks).into_par_iter().map(|c| chunk(c * CHUNK)).collect();
    #[cfg(not(feature = "threads"))]
    let parts: Vec<Result<Vec<A>>> = (0..chunks).map(|c| chunk(c * CHUNK)).collect();
    let mut out = Vec::with_capacity(count);
    for part in parts {
        out.extend(part?);
    }
    Ok(out)
}

fn no_answer(what: &str, i: usize, query: [f64; 3]) -> Error {
    match query.iter().position(|c| !c.is_finite()) {
        Some(axis) => Error::NonFinite { what: format!("query {i}"), index: axis, value: query[axis] },
        None => Error::mesh(what, "whole mesh", "has nothing finite to find", "give the part that can be reached"),
    }
}

impl<T: Real> NearestGrid<T> {
    /// [`NearestGrid::nearest`] of many queries [m], shape [query_count, 3]; `known` may hold an id per query, such as the
    /// answers of the frame before ([`NearestGrid::nearest_from`]).
    ///
    /// # Errors
    /// [`Error::NonFinite`] naming the first query that is not finite, [`Error::Mesh`] without points, [`Error::Length`] for
    /// another number of known answers.
    pub fn nearest_all(&self, queries: &[[T; 3]], known: Option<&[u32]>) -> Result<Vec<(u32, T)>> {
        in_chunks(queries.len(), known, |i, known| {
            let found = match known {
                None => self.nearest(&queries[i]),
                Some(id) => self.nearest_from(&queries[i], id),
            };
            let (id, d) = found.ok_or_else(|| no_answer("points to search", i, queries[i].map(Real::to_f64)))?;
            Ok((id, (id, d)))
        })
    }
}

impl NearestSurface {
    /// [`NearestSurface::nearest`] of many queries [m]; `known` may hold a triangle per query, such as those of the frame
    /// before ([`NearestSurface::nearest_from`]).
    ///
    /// # Errors
    /// [`Error::NonFinite`] naming the first query that is not finite, [`Error::Mesh`] without triangles, [`Error::Length`]
    /// for another number of known answers.
    pub fn nearest_all(&self, queries: &[Vec3], known: Option<&[u32]>) -> Result<Vec<SurfacePoint>> {
        in_chunks(queries.len(), known, |i, known| {
            let found = match known {
                None => self.nearest(&queries[i]),
                Some(face) => self.nearest_from(&queries[i], face),
            };
            let found = found.ok_or_else(|| no_answer("surface to search", i, queries[i].into()))?;
            Ok((found.face, found))
        })
    }
}
