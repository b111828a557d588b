//! What an image takes of flash and RAM, and what must not be in it.

use anyhow::{Context, Result};
use object::{Object, ObjectSection, ObjectSymbol};

/// Parts of the names of functions by which Rust panics or anything allocates.
const PANIC: &[&str] = &["panicking", "rust_begin_unwind", "unwrap_failed", "panic_fmt"];
const ALLOCATOR: &[&str] = &[
    "__rust_alloc",
    "__rust_dealloc",
    "__rust_realloc",
    "__rg_alloc",
    "malloc",
    "calloc",
    "realloc",
    "_sbrk",
    "alloc::alloc",
];

/// Bytes of an image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Sizes {
    /// Code and constants.
    pub(super) text: u64,
    /// Everything that is programmed into flash.
    pub(super) flash: u64,
    /// Everything that is in RAM before the stack.
    pub(super) ram: u64,
}

/// The sections' sizes.
pub(super) fn sizes(elf: &[u8]) -> Result<Sizes> {
    let file = object::File::parse(elf).context("the image is no ELF file")?;
    let of = |name: &str| file.section_by_name(name).map_or(0, |section| section.size());
    let text = of(".text") + of(".rodata");
    let data = of(".data");
    Ok(Sizes {
        text,
        flash: of(".vector_table") + text + data,
        ram: data + of(".bss") + of(".uninit"),
    })
}

/// Size of a symbol, if the image has it.
pub(super) fn symbol_size(elf: &[u8], name: &str) -> Result<Option<u64>> {
    let file = object::File::parse(elf).context("the image is no ELF file")?;
    let found = file.symbols().find(|symbol| symbol.name() == Ok(name));
    Ok(found.map(|symbol| symbol.size()))
}

/// Functions by which something could allocate, and, where `panics` is set, could panic.
pub(crate) fn forbidden(elf: &[u8], panics: bool) -> Result<Vec<String>> {
    let file = object::File::parse(elf).context("the image is no ELF file")?;
    let names = file.symbols().filter_map(|symbol| symbol.name().ok().map(str::to_owned));
    Ok(names.filter(|name| is_forbidden(name, panics)).collect())
}

fn is_forbidden(symbol: &str, panics: bool) -> bool {
    let any = |parts: &[&str]| parts.iter().any(|part| symbol.contains(part));
    any(ALLOCATOR) || symbol.contains("5alloc5alloc") || (panics && any(PANIC))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn symbols_are_judged_by_their_parts() {
        let panic = "_ZN4core9panicking9panic_fmt17h0123456789abcdefE";
        assert!(is_forbidden(panic, true) && !is_forbidden(panic, false));
        assert!(is_forbidden("__rust_alloc", false) && is_forbidden("malloc", false));
        assert!(is_forbidden("_ZN5alloc5alloc18handle_alloc_errorE", false));
        assert!(!is_forbidden("_ZN16rigidformer_core9simulatorE", true));
    }
}
