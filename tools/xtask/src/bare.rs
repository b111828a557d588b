//! README's two commands on a bare machine: a minimal Debian with Rust and a C linker and nothing else.

use std::collections::BTreeSet;
use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
#[cfg(unix)]
use signal_hook::consts::SIGHUP;
use signal_hook::consts::{SIGINT, SIGTERM};

use crate::process::{line, output, run as run_command};
use crate::report::minutes;
use crate::{apt, readme, sources, tools};

/// What a newcomer has besides Rust: a C linker, and the certificates that downloads are checked with.
const PACKAGES: &str = "--include=gcc,libc6-dev,ca-certificates";
/// Where toolchain and project are, in the root.
const RUST: &str = "opt/rust";
const PROJECT: &str = "root/rigidformer";
const PATH: &str = "/opt/rust/bin:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin";

/// Variables that tell cargo how to reach its registry.
const CARRIED: &[&str] = &["SSL_CERT_FILE", "SSL_CERT_DIR", "CURL_CA_BUNDLE"];
/// In capitals or not.
const PROXIES: &[&str] = &["http_proxy", "https_proxy", "all_proxy", "no_proxy"];
/// Beginnings of cargo's own; the others are what cargo tells the programs that it starts.
const CARGO: &[&str] =
    &["CARGO_HTTP_", "CARGO_NET_", "CARGO_REGISTRY_", "CARGO_REGISTRIES_", "CARGO_SOURCE_"];
/// Of those, and of what is in every Debian: files of certificates.
const CERTIFICATES: &[&str] = &["SSL_CERT_FILE", "CURL_CA_BUNDLE", "CARGO_HTTP_CAINFO"];
const DEBIAN_CERTIFICATES: &str = "/etc/ssl/certs/ca-certificates.crt";

/// Mounts the toolchain, read-only, and `/proc`, in a namespace of its own, and runs a command in the root.
const ENTER: &str = "mount --bind \"$1\" \"$2/opt/rust\" && \
    mount -o remount,bind,ro \"$2/opt/rust\" && mount -t proc proc \"$2/proc\" && \
    root=$2 && shift 2 && exec chroot \"$root\" \"$@\"";

/// Of `cargo xtask bare`.
#[derive(clap::Args)]
pub(crate) struct Options {
    /// Where the root is made, a folder that is empty or does not exist; a folder of cargo's where left out
    #[arg(long, value_name = "DIR")]
    root: Option<PathBuf>,
    /// Leaves the root there
    #[arg(long)]
    keep: bool,
}

/// Makes the root, runs both commands in it and says how long they took; `start` is the folder of the caller.
pub(crate) fn run(options: &Options, start: &Path) -> Result<()> {
    let [first, second] = readme::commands()?;
    if !apt::is_root() {
        bail!(
            "a root can be made and mounted by root alone: `sudo cargo xtask bare`, or in a container"
        );
    }
    if let Err(missing) = apt::ensure(&[tools::DEBOOTSTRAP]) {
        bail!("{missing}");
    }
    isolation()?;
    let toolchain = toolchain()?;
    let interrupted = Arc::new(AtomicBool::new(false));
    for signal in [
        SIGINT,
        SIGTERM,
        #[cfg(unix)]
        SIGHUP,
    ] {
        signal_hook::flag::register(signal, Arc::clone(&interrupted))
            .context("cannot listen for signals")?;
    }

    let root = Root::new(options.root.as_ref().map(|root| start.join(root)), options.keep)?;
    let machine = Machine { root: &root.path, toolchain: &toolchain, interrupted: &interrupted };
    machine.debootstrap()?;
    machine.carry()?;
    machine.check_out()?;
    let before = machine.packages()?;
    let mut took = Vec::new();
    for command in [&first, &second] {
        println!("== {}", readme::bare(command));
        let begin = Instant::now();
        let status = machine.shell(command)?;
        if !status.success() {
            bail!("`{}` failed on a bare machine: {status}", readme::bare(command));
        }
        took.push((command, begin.elapsed()));
    }
    let after = machine.packages()?;
    let changed: Vec<&String> = before.symmetric_difference(&after).collect();
    if !changed.is_empty() {
        bail!("the commands changed the packages of the machine: {changed:?}");
    }
    println!(
        "== on a bare machine with {} packages, none of them installed by the commands:",
        after.len()
    );
    for (command, took) in took {
        println!("{:>12}  {}", minutes(took), readme::bare(command));
    }
    Ok(())
}

/// Namespaces keep mounts and processes from outliving this program, whatever ends it.
fn isolation() -> Result<()> {
    let mut command = Command::new("unshare");
    command.args(["--mount", "--pid", "--fork", "--kill-child", "true"]);
    output(&mut command).map(drop).context(
        "namespaces for mounts and processes are needed: unshare of util-linux, and in a container \
         the right to use them (such as --privileged)",
    )
}

/// The folder of the Rust that runs this.
fn toolchain() -> Result<PathBuf> {
    let sysroot =
        PathBuf::from(output(Command::new("rustc").args(["--print", "sysroot"]))?.trim_end());
    for program in ["cargo", "rustc"] {
        if !sysroot.join("bin").join(program).is_file() {
            bail!("{} has no bin/{program}: use a Rust that rustup installed", sysroot.display());
        }
    }
    if sysroot == Path::new("/usr") {
        bail!("this Rust is part of the system: use one that rustup installed");
    }
    Ok(sysroot)
}

/// A folder that is removed in the end.
struct Root {
    path: PathBuf,
    keep: bool,
}

impl Root {
    fn new(path: Option<PathBuf>, keep: bool) -> Result<Root> {
        let path = match path {
            Some(path) => {
                fs::create_dir_all(&path)
                    .with_context(|| format!("cannot make {}", path.display()))?;
                if fs::read_dir(&path)?.next().is_some() {
                    bail!("{} is not empty", path.display());
                }
                path
            }
            None => {
                let target = env::var_os("CARGO_TARGET_DIR").unwrap_or_else(|| "target".into());
                fs::create_dir_all(&target).context("cannot make cargo's folder")?;
                tempfile::Builder::new()
                    .prefix("bare-")
                    .tempdir_in(&target)
                    .context("cannot make a folder for the root")?
                    .keep()
            }
        };
        let path = path.canonicalize()?;
        println!("== root: {}", path.display());
        Ok(Root { path, keep })
    }

    fn remove(&self) -> Result<()> {
        let mounts = fs::read_to_string("/proc/self/mounts").context("no list of mounts")?;
        if let Some(mount) = mount_below(&mounts, &self.path) {
            bail!("{mount} is mounted");
        }
        // The last processes of a run that was ended may still be writing.
        let mut attempts = 100;
        loop {
            match fs::remove_dir_all(&self.path) {
                Ok(()) => return Ok(()),
                Err(error) if attempts == 0 => return Err(error.into()),
                Err(_) => attempts -= 1,
            }
            thread::sleep(Duration::from_millis(100));
        }
    }
}

impl Drop for Root {
    fn drop(&mut self) {
        if self.keep {
            println!("{} is kept", self.path.display());
        } else if let Err(error) = self.remove() {
            println!("{} is left: {error:#}", self.path.display());
        }
    }
}

/// A mount point below a folder: removing the folder would empty what is mounted.
fn mount_below<'m>(mounts: &'m str, folder: &Path) -> Option<&'m str> {
    let mut points = mounts.lines().filter_map(|line| line.split(' ').nth(1));
    points.find(|point| Path::new(point).starts_with(folder))
}

/// The bare machine.
struct Machine<'a> {
    root: &'a Path,
    toolchain: &'a Path,
    interrupted: &'a AtomicBool,
}

impl Machine<'_> {
    /// Fills the root from the archive that this machine uses.
    fn debootstrap(&self) -> Result<()> {
        let sources = sources::debian()?;
        let with_suite =
            sources.iter().find_map(|source| Some((source, source.releases().next()?)));
        let (source, suite) =
            with_suite.context("the apt sources of this machine name no suite of Debian")?;
        let mut command = isolated();
        command.args(["debootstrap", "--variant=minbase", PACKAGES]);
        if let Some(keys) = &source.signed_by {
            command.arg(format!("--keyring={keys}"));
        }
        command.arg(suite).arg(self.root).arg(&source.uri);
        let mut proxy = Command::new("apt-config");
        proxy.args(["dump", "--format", "%v%n", "Acquire::http::Proxy"]);
        let proxy = output(&mut proxy).unwrap_or_default();
        if !proxy.trim().is_empty() && env::var_os("http_proxy").is_none() {
            command.env("http_proxy", proxy.trim());
        }
        println!("{}", line(&command));
        let status = self.wait(&mut command)?;
        if !status.success() {
            bail!(
                "debootstrap failed: {status}; {} tells why with --keep",
                self.root.join("debootstrap/debootstrap.log").display()
            );
        }
        Ok(())
    }

    /// Gives the root this machine's way to cargo's registry: names, certificates, settings.
    fn carry(&self) -> Result<()> {
        let mut files: Vec<PathBuf> =
            ["/etc/resolv.conf", "/etc/hosts", DEBIAN_CERTIFICATES].map(PathBuf::from).into();
        files.extend(CERTIFICATES.iter().filter_map(env::var_os).map(PathBuf::from));
        let home = env::var_os("CARGO_HOME")
            .map(PathBuf::from)
            .or_else(|| env::var_os("HOME").map(|home| Path::new(&home).join(".cargo")));
        for name in ["config.toml", "config"] {
            let Some(text) =
                home.as_ref().and_then(|home| fs::read_to_string(home.join(name)).ok())
            else {
                continue;
            };
            files.extend(cainfo(&text));
            let to = self.root.join("root/.cargo").join(name);
            write(&to, text.as_bytes())?;
        }
        for file in files.iter().filter(|file| file.is_file() && file.is_absolute()) {
            let bytes =
                fs::read(file).with_context(|| format!("cannot read {}", file.display()))?;
            write(&self.root.join(file.strip_prefix("/").unwrap_or(file)), &bytes)?;
        }
        fs::create_dir_all(self.root.join(RUST)).context("cannot make a folder for the toolchain")
    }

    /// A fresh copy of what is committed.
    fn check_out(&self) -> Result<()> {
        if !output(Command::new("git").args(["status", "--porcelain"]))?.trim().is_empty() {
            println!("what is not committed is left out");
        }
        let project = self.root.join(PROJECT);
        fs::create_dir_all(&project).context("cannot make a folder for the project")?;
        let archive = self.root.join("tmp/project.tar");
        run_command(Command::new("git").args(["archive", "--output"]).arg(&archive).arg("HEAD"))?;
        let mut unpack = Command::new("tar");
        unpack.arg("--extract").arg("--file").arg(&archive).arg("--directory").arg(&project);
        run_command(&mut unpack)?;
        fs::remove_file(&archive).context("cannot remove the archive")
    }

    /// Names and versions of the installed packages.
    fn packages(&self) -> Result<BTreeSet<String>> {
        let mut command = Command::new("dpkg-query");
        command.arg(format!("--admindir={}", self.root.join("var/lib/dpkg").display()));
        let text = output(command.arg("--show"))?;
        Ok(text.lines().map(str::to_owned).collect())
    }

    /// Runs a line of a shell in the project's folder, with little more than PATH in its environment.
    fn shell(&self, text: &str) -> Result<ExitStatus> {
        let mut command = isolated();
        command.args(["sh", "-c", ENTER, "sh"]).arg(self.toolchain).arg(self.root);
        command.args(["env", "-i", &format!("--chdir=/{PROJECT}"), "HOME=/root"]);
        command.arg(format!("PATH={PATH}"));
        let variables = env::vars().filter(|(name, _)| is_carried(name));
        command.args(variables.map(|(name, value)| format!("{name}={value}")));
        command.args(["sh", "-c", text]);
        self.wait(&mut command)
    }

    /// Runs a command to its end, or kills it when this program is interrupted.
    fn wait(&self, command: &mut Command) -> Result<ExitStatus> {
        let mut child = command
            .stdin(Stdio::null())
            .spawn()
            .with_context(|| format!("cannot start `{}`", line(command)))?;
        loop {
            if self.interrupted.load(Ordering::Relaxed) {
                // Its namespace, and all that runs there, ends with it.
                child.kill().context("cannot end what runs in the root")?;
                child.wait()?;
                bail!("interrupted");
            }
            if let Some(status) = child.try_wait()? {
                return Ok(status);
            }
            thread::sleep(Duration::from_millis(50));
        }
    }
}

fn isolated() -> Command {
    let mut command = Command::new("unshare");
    command.args(["--mount", "--pid", "--fork", "--kill-child"]);
    command
}

fn is_carried(name: &str) -> bool {
    CARRIED.contains(&name)
        || PROXIES.contains(&name.to_lowercase().as_str())
        || CARGO.iter().any(|start| name.starts_with(start))
}

/// The certificates that cargo's configuration names.
fn cainfo(config: &str) -> Option<PathBuf> {
    let table: toml::Table = toml::from_str(config).ok()?;
    Some(table.get("http")?.get("cainfo")?.as_str()?.into())
}

fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    }
    // A link would lead out of the root.
    if path.is_symlink() {
        fs::remove_file(path).with_context(|| format!("cannot replace {}", path.display()))?;
    }
    fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_way_to_the_registry_is_carried() {
        for name in ["CARGO_HTTP_PROXY", "CARGO_REGISTRIES_OURS_INDEX", "HTTPS_PROXY", "no_proxy"] {
            assert!(is_carried(name), "{name}");
        }
        for name in ["CARGO_MANIFEST_DIR", "CARGO_TARGET_DIR", "CARGO", "PATH", "CI", "RUSTFLAGS"] {
            assert!(!is_carried(name), "{name}");
        }
    }

    #[test]
    fn certificates_of_the_configuration_are_found() {
        let config = "[http]\ncainfo = \"/ours.pem\"\n[net]\nretry = 3\n";
        assert_eq!(cainfo(config), Some("/ours.pem".into()));
        assert_eq!(cainfo("[net]\nretry = 3\n"), None);
        assert_eq!(cainfo("[net"), None);
    }

    #[test]
    fn a_mount_below_the_root_is_seen() {
        let mounts = "proc /proc proc rw 0 0\n/dev/a /r/bare-1x ext4 rw 0 0\nproc /r/bare-1/proc proc rw 0 0\n";
        assert_eq!(mount_below(mounts, Path::new("/r/bare-1")), Some("/r/bare-1/proc"));
        assert_eq!(mount_below(mounts, Path::new("/r/bare")), None);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn the_root_must_be_empty_and_is_removed() -> Result<()> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("root");
        let root = Root::new(Some(path.clone()), false)?;
        fs::write(path.join("file"), "")?;
        assert!(Root::new(Some(path.clone()), true).is_err());
        drop(root);
        assert!(!path.exists());
        Ok(())
    }
}
