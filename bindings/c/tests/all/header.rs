//! The header, and the examples of the documentation, as compilers see them. `cargo xtask capi` links
//! and runs what is only compiled here.
#![cfg(not(miri))]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::io::Write;
use std::process::{Command, Stdio};

const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");

/// Compiles a text, or panics with what the compiler says; does nothing where there is no compiler.
fn compiles(what: &str, compiler: &str, language: &str, standard: &str, text: &str) {
    let mut command = Command::new(compiler);
    command.args(["-fsyntax-only", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-x", language]);
    command.args([standard, &format!("-I{ROOT}/bindings/c/include"), "-"]);
    let child = command.stdin(Stdio::piped()).stderr(Stdio::piped()).spawn();
    let Ok(mut child) = child else {
        println!("skipped: no {compiler}");
        return;
    };
    child.stdin.take().unwrap().write_all(text.as_bytes()).unwrap();
    let output = child.wait_with_output().unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{what} as {language} {standard}:\n{errors}");
}

#[test]
fn the_header_is_c89_and_cpp11() {
    let text = "#include <rigidformer.h>\n";
    for standard in ["-std=c89", "-std=c99", "-std=c11", "-std=c17"] {
        compiles("the header", "cc", "c", standard, text);
    }
    for standard in ["-std=c++11", "-std=c++17", "-std=c++20"] {
        compiles("the header", "c++", "c++", standard, text);
    }
}

/// Braces of C++ narrow nothing: a constant has the sign of the fields that take it, also where it is one of two.
#[test]
fn constants_go_into_braces() {
    let text = r#"
#include <rigidformer.h>
#include <vector>
rf_status use(rf_simulator *simulator, bool is_fixed, bool is_own, const std::vector<float> &points) {
    const rf_unit unit{{1.0f, 0.5f, 0.4f}, is_fixed ? RF_ROLE_FIXED : RF_ROLE_FREE, is_own ? RF_OWN_BODY : RF_MAX_BODY,
                       points.data(), points.size() / 3, {0, 0, 0}, nullptr, nullptr, 0};
    const std::vector<uint32_t> numbers{is_own ? RF_NONE : RF_ABI_VERSION, is_own ? RF_ROLE_DRIVEN : RF_QUANTITIES};
    const std::vector<std::size_t> sizes{is_own ? RF_ALIGNMENT : RF_MAX_PLANES, is_own ? RF_MAX_PIECES : RF_ALIGNMENT};
    const rf_pose pose{{0, 0, 1}, {0, 0, 0, 1}};
    return numbers.size() == sizes.size() ? rf_add(simulator, &unit, &pose, &pose, nullptr) : RF_OK;
}
"#;
    for standard in ["-std=c++11", "-std=c++17", "-std=c++20"] {
        compiles("constants in braces", "c++", "c++", standard, text);
    }
}

#[test]
fn sizes_are_those_of_rust() {
    use rigidformer_capi::types::*;
    let mut text = String::from("#include <rigidformer.h>\n");
    for (name, size) in [
        ("rf_status", size_of::<rf_status>()),
        ("rf_config", size_of::<rf_config>()),
        ("rf_units", size_of::<rf_units>()),
        ("rf_unit", size_of::<rf_unit>()),
        ("rf_unit_id", size_of::<rf_unit_id>()),
        ("rf_plane", size_of::<rf_plane>()),
        ("rf_height_field", size_of::<rf_height_field>()),
        ("rf_bonded", size_of::<rf_bonded>()),
        ("rf_detail", size_of::<rf_detail>()),
        ("rf_compliance", size_of::<rf_compliance>()),
        ("rf_physics", size_of::<rf_physics>()),
        ("rf_pose", size_of::<rf_pose>()),
        ("rf_velocity", size_of::<rf_velocity>()),
        ("rf_internal_pose", size_of::<rf_internal_pose>()),
        ("rf_observation", size_of::<rf_observation>()),
        ("rf_step_report", size_of::<rf_step_report>()),
        ("rf_health", size_of::<rf_health>()),
    ] {
        text += &format!("_Static_assert(sizeof({name}) == {size}, \"{name}\");\n");
    }
    compiles("sizes", "cc", "c", "-std=c11", &text);
}

/// Programs in C in the pages for users, and a part of one.
#[test]
fn the_examples_of_the_documentation_compile() {
    let small =
        std::fs::read_to_string(format!("{ROOT}/bindings/c/examples/host/small.c")).unwrap();
    compiles("small.c", "cc", "c", "-std=c11", &small);
    let push = std::fs::read_to_string(format!("{ROOT}/bindings/c/examples/push.c")).unwrap();
    for page in ["README.md", "docs/C.md"] {
        let text = std::fs::read_to_string(format!("{ROOT}/{page}")).unwrap();
        let blocks = text.split("```c\n").skip(1).filter_map(|rest| rest.split("```").next());
        for block in blocks {
            let known = block == small || push.contains(block);
            assert!(known, "{page} shows what is not in bindings/c/examples:\n{block}");
        }
    }
    for name in ["push.c", "host/push.c", "host/walk.c", "host/drape.c"] {
        let text = std::fs::read_to_string(format!("{ROOT}/bindings/c/examples/{name}")).unwrap();
        let folder = format!("{ROOT}/bindings/c/examples");
        let text = text.replace("\"../push.h\"", &format!("\"{folder}/push.h\""));
        let text = text.replace("\"push.h\"", &format!("\"{folder}/push.h\""));
        compiles(name, "cc", "c", "-std=c11", &text);
    }
    let wrapper = std::fs::read_to_string(format!("{ROOT}/bindings/c/examples/host/simulator.hpp"));
    let wrapper = wrapper.unwrap().replace("#pragma once\n", "");
    compiles("simulator.hpp", "c++", "c++", "-std=c++17", &wrapper);
}
