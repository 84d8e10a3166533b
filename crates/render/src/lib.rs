//! A small z-buffer renderer for label views and for pictures.
