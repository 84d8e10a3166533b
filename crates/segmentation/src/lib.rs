//! Segmenters of caphy and the fusion of their labels over views.
