//! caphy.
