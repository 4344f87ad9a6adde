//! The product through its sockets: REST, gRPC, events and the page, as its users meet them.

mod authorization;
mod comparison;
mod document;
mod grpc;
mod harness;
mod hold;
mod investigations;
mod measurements;
mod protocol;
mod refusals;
mod repose;
mod simulators;
mod tls;
mod toy;
mod weighing;
