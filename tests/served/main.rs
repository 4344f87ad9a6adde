//! `flip serve` in a process of its own: commands beside it, and what it loses when it is killed.

mod beside;
mod harness;
mod restart;
