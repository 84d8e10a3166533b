//! Garment templates, skinning, energies, relaxation and fabric estimation of caphy.
