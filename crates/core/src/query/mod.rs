//! Mesh queries that several crates need: adjacency, boundary loops, hinges, exact nearest vertices and surface points.
//!
//! Nearest vertices ([`NearestGrid`]) are searched in a uniform grid, in growing shells of cells around the query, nearest
//! points of triangles ([`NearestSurface`]) in a tree of boxes, until nothing that is left can be nearer. Answers are exact,
//! equal distances go to the smallest id, and so neither the order of building, nor a known earlier answer that shortens the
//! search (`nearest_from`), nor the number of threads (`nearest_all`) changes a bit of them. A query that is not finite has
//! no answer. Batches of frames of one deforming surface have a search of their own, [`NearestInLanes`].

mod adjacency;
mod batch;
mod cells;
mod edges;
mod fans;
mod lanes;
mod side;
mod surface;
mod triangle;
mod vertices;

pub use adjacency::Adjacency;
pub use edges::{Hinge, boundary_loops, hinges};
pub use fans::Fans;
pub use lanes::{Asked, LaneAnswers, LaneBoxes, NearestInLanes};
pub use side::PseudoNormals;
pub use surface::{NearestSurface, SurfacePoint};
pub use triangle::{TriangleFeature, TrianglePoint, nearest_on_line, nearest_on_triangle};
pub use vertices::NearestGrid;
