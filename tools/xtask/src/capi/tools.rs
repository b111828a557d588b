//! Programs of the machine, and the Debian packages that hold them.

use std::process::Command;

use crate::process::{line, output, run};
use crate::rust_src::is_root_with_apt;

pub(super) struct Tool {
    program: &'static str,
    packages: &'static [&'static str],
}

impl Tool {
    pub(super) const CC: Tool = Tool { program: "cc", packages: &["gcc", "libc6-dev"] };
    pub(super) const CXX: Tool = Tool { program: "c++", packages: &["g++"] };
    pub(super) const CMAKE: Tool = Tool { program: "cmake", packages: &["cmake"] };
    pub(super) const PKG_CONFIG: Tool = Tool { program: "pkg-config", packages: &["pkg-config"] };
    pub(super) const MAKE: Tool = Tool { program: "make", packages: &["make"] };
    pub(super) const ARM_GCC: Tool =
        Tool { program: "arm-none-eabi-gcc", packages: &["gcc-arm-none-eabi"] };
    pub(super) const QEMU: Tool =
        Tool { program: "qemu-system-arm", packages: &["qemu-system-arm"] };
}

/// Installs what is missing, or says why it cannot.
pub(super) fn provide(tools: &[Tool]) -> Result<(), String> {
    let missing: Vec<&Tool> = tools.iter().filter(|tool| !works(tool)).collect();
    if missing.is_empty() {
        return Ok(());
    }
    let mut apt = Command::new("apt-get");
    apt.args(["install", "--yes", "--no-install-recommends"]);
    apt.args(missing.iter().flat_map(|tool| tool.packages));
    let names: Vec<&str> = missing.iter().map(|tool| tool.program).collect();
    let names = names.join(", ");
    is_root_with_apt().map_err(|why| format!("no {names}, and {why}; by hand: {}", line(&apt)))?;
    // Lists that were never fetched make the first attempt fail.
    run(&mut apt)
        .or_else(|_| run(Command::new("apt-get").arg("update")))
        .and_then(|()| run(&mut apt))
        .map_err(|error| format!("no {names}: {error:#}"))?;
    match missing.iter().find(|tool| !works(tool)) {
        Some(tool) => Err(format!("no {} even from {:?}", tool.program, tool.packages)),
        None => Ok(()),
    }
}

fn works(tool: &Tool) -> bool {
    output(Command::new(tool.program).arg("--version")).is_ok()
}
