//! Body models of caphy: the SMPL-X layout, a mannequin, registration under clothing.
