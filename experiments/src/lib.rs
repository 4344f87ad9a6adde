//! What the programs of `src/bin` share. Each of them makes a table of docs, or the numbers behind one.

pub mod calibrated;
pub mod orders;
