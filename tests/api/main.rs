//! The product through its sockets: REST, gRPC, events and the page, as its users meet them.

mod archive;
mod asked;
mod authorization;
mod characterisations;
mod comparison;
mod document;
mod grpc;
mod harness;
mod hold;
mod investigations;
mod log;
mod measurements;
mod protocol;
mod record;
mod refusals;
mod repose;
mod search;
mod shakes;
mod simulators;
mod stop;
mod tls;
mod tokens;
mod toy;
mod trouble;
mod weighing;
