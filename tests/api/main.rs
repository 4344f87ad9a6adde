//! The product through its sockets: REST, gRPC, events and the page, as its users meet them.

mod document;
mod harness;
mod protocol;
