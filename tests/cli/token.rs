//! `flip token`.

use crate::harness::{document, expect_status, flip};

#[test]
fn tokens_are_made_with_a_role() {
    let folder = tempfile::tempdir().unwrap();
    let output = flip(folder.path(), &["token", "create", "--role", "operator", "--json"]);
    expect_status(&output, 0);
    assert_eq!(document(&output)["role"], "operator");
    assert!(document(&output)["token"].as_str().unwrap().starts_with("flip_"));
}
