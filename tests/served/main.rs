//! `flip serve` in a separate process: commands alongside it, and what it loses when killed.

mod beside;
mod harness;
mod restart;
