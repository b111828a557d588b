//! Kernels by name, and which of them this processor can run.

use std::fmt;
use std::str::FromStr;

use rigidformer_core::Portable;

#[cfg(all(target_arch = "aarch64", target_endian = "little"))]
use crate::aarch64;
use crate::host::HostKernels;
#[cfg(target_arch = "x86_64")]
use crate::x86;

/// Environment variable that forces a kernel, such as `RIGIDFORMER_KERNEL=portable`.
pub const VARIABLE: &str = "RIGIDFORMER_KERNEL";

/// Kernels by name, fastest last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Kernel {
    /// Plain Rust, everywhere.
    Portable,
    /// x86-64 with AVX2 and F16C.
    Avx2,
    /// x86-64 with AVX-VNNI.
    AvxVnni,
    /// x86-64 with AVX-512 VNNI.
    Avx512Vnni,
    /// x86-64 with AVX-512 VNNI and AMX for int8, which Linux must grant: from then on it refuses the process signal stacks
    /// (`sigaltstack`) that are too small for AMX's registers, about 11 kB. Another kernel in [`VARIABLE`] does not ask.
    Amx,
    /// Any aarch64.
    Neon,
    /// aarch64 with SDOT (Armv8.2 dot product).
    Sdot,
    /// aarch64 with SDOT and SMMLA (Armv8.6 int8 matrix multiplication).
    Smmla,
}

impl Kernel {
    /// All kernels, on any processor.
    pub const ALL: [Kernel; 8] = [
        Kernel::Portable,
        Kernel::Avx2,
        Kernel::AvxVnni,
        Kernel::Avx512Vnni,
        Kernel::Amx,
        Kernel::Neon,
        Kernel::Sdot,
        Kernel::Smmla,
    ];

    /// As in [`VARIABLE`].
    pub fn name(self) -> &'static str {
        match self {
            Kernel::Portable => "portable",
            Kernel::Avx2 => "avx2",
            Kernel::AvxVnni => "avx-vnni",
            Kernel::Avx512Vnni => "avx512-vnni",
            Kernel::Amx => "amx",
            Kernel::Neon => "neon",
            Kernel::Sdot => "sdot",
            Kernel::Smmla => "smmla",
        }
    }

    /// Those that this processor can run, fastest last. The order of `sdot` and `smmla` is that of counted instructions: no timings exist.
    ///
    /// ```
    /// use rigidformer_kernels::Kernel;
    /// assert_eq!(Kernel::available()[0], Kernel::Portable);
    /// ```
    pub fn available() -> Vec<Kernel> {
        Kernel::ALL.into_iter().filter(|kernel| kernel.is_there()).collect()
    }

    /// The one that [`VARIABLE`] names, else the fastest of this processor.
    ///
    /// # Errors
    /// [`KernelError`] where the variable names none, or one that this processor cannot run.
    pub fn chosen() -> Result<Kernel, KernelError> {
        // An empty variable counts as unset, as shells leave it.
        let Some(name) = std::env::var_os(VARIABLE).filter(|name| !name.is_empty()) else {
            return Ok(Kernel::available().last().copied().unwrap_or(Kernel::Portable));
        };
        // Other kernels are not probed: AMX has a price, larger signal stacks for the whole process.
        let kernel: Kernel = name.to_string_lossy().parse()?;
        if kernel.is_there() { Ok(kernel) } else { Err(KernelError::Lacking { kernel }) }
    }

    /// Whether this processor can run them.
    fn is_there(self) -> bool {
        struct Probe;
        impl Run for Probe {
            type Output = ();
            fn run<K: HostKernels>(self, _: K) {}
        }
        self.run(Probe).is_some()
    }

    /// Runs `rounds` rounds of int8 multiply-accumulates by [`instruction`](Self::instruction) on registers alone: the upper
    /// bound of a product's speed. Returns the multiply-accumulates of a round, or `None` where they are not known.
    pub fn ceiling(self, rounds: u64) -> Option<u64> {
        match self {
            #[cfg(target_arch = "x86_64")]
            Kernel::Avx2 => x86::ceiling::avx2(rounds),
            #[cfg(target_arch = "x86_64")]
            Kernel::AvxVnni => x86::ceiling::avx_vnni(rounds),
            #[cfg(target_arch = "x86_64")]
            Kernel::Avx512Vnni | Kernel::Amx => x86::ceiling::avx512(rounds),
            _ => {
                let _ = rounds;
                None
            }
        }
    }

    /// What the [ceiling](Self::ceiling) consists of, where it is known. For `amx` it is VNNI's, which multiplies small matrices.
    pub fn instruction(self) -> Option<&'static str> {
        match self {
            Kernel::Avx2 => Some("vpmaddubsw"),
            Kernel::AvxVnni => Some("vpdpbusd of 256 bits"),
            Kernel::Avx512Vnni | Kernel::Amx => Some("vpdpbusd of 512 bits"),
            Kernel::Portable | Kernel::Neon | Kernel::Sdot | Kernel::Smmla => None,
        }
    }

    /// Runs `task` with a value of these kernels, or returns `None` where the processor lacks them.
    pub fn run<R: Run>(self, task: R) -> Option<R::Output> {
        match self {
            Kernel::Portable => Some(task.run(Portable)),
            #[cfg(target_arch = "x86_64")]
            Kernel::Avx2 => Some(task.run(x86::Avx2::detect()?)),
            #[cfg(target_arch = "x86_64")]
            Kernel::AvxVnni => Some(task.run(x86::AvxVnni::detect()?)),
            #[cfg(target_arch = "x86_64")]
            Kernel::Avx512Vnni => Some(task.run(x86::Avx512Vnni::detect()?)),
            #[cfg(target_arch = "x86_64")]
            Kernel::Amx => Some(task.run(x86::Amx::detect()?)),
            #[cfg(all(target_arch = "aarch64", target_endian = "little"))]
            Kernel::Neon => Some(task.run(aarch64::Neon::detect()?)),
            #[cfg(all(target_arch = "aarch64", target_endian = "little"))]
            Kernel::Sdot => Some(task.run(aarch64::Sdot::detect()?)),
            #[cfg(all(target_arch = "aarch64", target_endian = "little"))]
            Kernel::Smmla => Some(task.run(aarch64::Smmla::detect()?)),
            #[allow(unreachable_patterns)]
            _ => None,
        }
    }
}

impl fmt::Display for Kernel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Kernel {
    type Err = KernelError;

    fn from_str(name: &str) -> Result<Self, KernelError> {
        let unknown = || KernelError::Unknown { name: name.into() };
        Kernel::ALL.into_iter().find(|kernel| kernel.name() == name).ok_or_else(unknown)
    }
}

/// A task on kernels whose type is known at run time alone.
pub trait Run {
    /// Its result.
    type Output;

    /// Runs it.
    fn run<K: HostKernels>(self, kernels: K) -> Self::Output;
}

/// Why a kernel cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum KernelError {
    /// No kernel has that name.
    #[error("no kernel is called {name:?}; {VARIABLE} is one of {}, or not set", names(&Kernel::ALL))]
    Unknown {
        /// The name.
        name: String,
    },
    /// The processor lacks its instructions.
    #[error("this processor cannot run {kernel} kernels; {VARIABLE} is one of {}, or not set", names(&Kernel::available()))]
    Lacking {
        /// The kernel.
        kernel: Kernel,
    },
}

fn names(kernels: &[Kernel]) -> String {
    kernels.iter().map(|kernel| kernel.name()).collect::<Vec<_>>().join(", ")
}
