//! A broken law fails its check: the suite cannot pass for nothing.
