//! The command line as scripts see it: the real binary, its exit status, its single document.

mod bench;
mod characterise;
mod compare;
mod config;
mod discover;
mod doctor;
mod every_command;
mod export;
mod film;
mod harness;
mod heap;
mod measurements;
mod policy;
mod serve;
mod server;
mod shakes;
mod token;
mod train;
mod validate;
mod weigh_list;
