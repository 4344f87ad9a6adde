//! The only SQL and the only files: one SQLite database and a folder of content-addressed artifacts.

pub mod evaluations;
pub mod events;
pub mod jobs;
pub mod page;
pub mod parameter_sets;
pub mod policies;
pub mod powders;
pub mod tokens;
pub mod trials;
pub mod weighings;
