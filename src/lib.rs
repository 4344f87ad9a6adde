#![doc = include_str!("ARCHITECTURE.md")]

pub mod domain;

pub mod sim;
pub mod stats;

pub mod pile;
pub mod policy;

pub mod calibrate;
pub mod discover;
pub mod train;
pub mod weigh;

pub mod emulate;
pub mod hardware;
pub mod store;

pub mod api;
pub mod app;
pub mod cli;
pub mod jobs;
pub mod telemetry;
