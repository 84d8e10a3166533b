//! Deformation nets of caphy: GRU and MLP with their vector-Jacobian products.
