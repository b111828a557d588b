//! Programs from the machine's own package sources.

use std::process::Command;

use crate::process::{line, output, run as run_command};
use crate::rust_src::is_root_with_apt;

/// Makes sure that programs are there, or tells why they cannot be had and what to do by hand.
pub(crate) fn ensure(programs: &[&str], packages: &[&str]) -> Result<(), String> {
    let Some(missing) = programs.iter().find(|program| !works(program)) else {
        return Ok(());
    };
    let mut apt = Command::new("apt-get");
    apt.args(["install", "--yes", "--no-install-recommends"]).args(packages);
    if let Err(why) = is_root_with_apt() {
        return Err(format!("no {missing}, and {why}; by hand: {}", line(&apt)));
    }
    // Lists that were never fetched make the first attempt fail.
    run_command(&mut apt)
        .or_else(|_| run_command(Command::new("apt-get").arg("update")))
        .and_then(|()| run_command(&mut apt))
        .map_err(|error| format!("no {missing}: {error:#}"))
}

fn works(program: &str) -> bool {
    output(Command::new(program).arg("--version")).is_ok()
}
