//! Every parser of external input, fed with damaged and hostile bytes: no panic, no waste of time
//! or memory, and the invariants of each.
//!
//! Each target runs for `FLIP_FUZZ_SECONDS` (default 2; `make reliability` sets 60) from the seed
//! `FLIP_FUZZ_SEED` (default 1), two in parallel on two cores. `corpus/<target>/` holds the files
//! it begins with. A failing input is minimised and kept there as `found-…`: every later run checks
//! it first.

mod arm;
mod balance;
mod bench_file;
mod camera;
mod corpus;
mod engine;
mod engine_tests;
mod gate;
mod modbus;
mod mutate;

use engine::fuzz;

#[test]
fn mt_sics_lines_are_read_as_shown_or_refused() {
    fuzz(&balance::MT_SICS);
}

#[test]
fn ohaus_lines_are_read_as_shown_or_refused() {
    fuzz(&balance::OHAUS);
}

#[test]
fn sbi_lines_are_read_as_shown_or_refused() {
    fuzz(&balance::SBI);
}

#[test]
fn aandd_lines_are_read_as_shown_or_refused() {
    fuzz(&balance::AANDD);
}

#[test]
fn decimals_become_the_milligrams_that_they_show() {
    fuzz(&balance::DECIMAL);
}

#[test]
fn gripper_states_hold_every_bit_that_was_sent() {
    fuzz(&modbus::STATUS);
}

#[test]
fn modbus_requests_with_a_flipped_bit_are_refused() {
    fuzz(&modbus::REQUEST);
}

#[test]
fn gate_replies_with_a_flipped_bit_are_refused() {
    fuzz(&gate::REPLY);
}

#[test]
fn gate_requests_with_a_flipped_bit_are_refused() {
    fuzz(&gate::REQUEST);
}

#[test]
fn camera_frames_have_the_size_that_they_say() {
    fuzz(&camera::FRAME);
}

#[test]
fn arm_limits_are_never_wider_than_those_of_an_action() {
    fuzz(&arm::DESCRIPTION);
}

#[test]
fn arm_messages_are_written_as_they_are_read() {
    fuzz(&arm::MESSAGE);
}

#[test]
fn bench_files_are_written_as_they_are_read() {
    fuzz(&bench_file::FILE);
}
