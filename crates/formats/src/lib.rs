//! File formats of caphy: OBJ, PLY, NPZ, ASF/AMC in; OBJ sequence and GLB out.
