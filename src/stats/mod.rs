//! Pure numerics used by calibration, evaluation and discovery.
