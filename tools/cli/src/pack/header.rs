//! `rigidformer pack --header`

use std::fmt::Write;
use std::path::Path;

use rigidformer_runtime::core::weights::MAGIC;
use rigidformer_runtime::files::read_whole;
use rigidformer_runtime::models::LoadedModel;

use crate::arguments::Pack;
use crate::output;

/// What the array is called unless told otherwise.
const NAME: &str = "rf_model";
/// Bytes in a line of the header.
const IN_A_LINE: usize = 24;
/// What the runtime asks of a model's address.
const ALIGNMENT: usize = 16;

/// Writes a packed model as a C header.
pub(super) fn run(arguments: &Pack, input: &Path) -> anyhow::Result<()> {
    output::apart("--out", &arguments.out, [input])?;
    let bytes = read_whole(input)?;
    if !bytes.starts_with(&MAGIC) {
        anyhow::bail!("{}: is no packed model; pack it first, without --header", input.display());
    }
    let loaded = LoadedModel::copy_of(input, &bytes)?;
    let crc = loaded.model().file().payload_crc();
    let name = arguments.name.as_deref().unwrap_or(NAME);
    let text = header(name, &bytes, crc)?;
    output::write_whole(&arguments.out, text.as_bytes())?;
    output::line(format_args!(
        "{}: {name} of {} bytes, aligned to {ALIGNMENT}, weights CRC-32 {crc:08x}",
        arguments.out.display(),
        bytes.len()
    ))
}

fn header(name: &str, bytes: &[u8], crc: u32) -> Result<String, std::fmt::Error> {
    let (guard, count) = (name.to_ascii_uppercase(), bytes.len());
    let mut text = format!(
        "/* A packed RigidFormer model, weights CRC-32 {crc:08x}; written by `rigidformer pack --header`. */
#ifndef {guard}_H
#define {guard}_H

#if defined(__cplusplus)
#define {guard}_ALIGNED alignas({ALIGNMENT})
#elif defined(__STDC_VERSION__) && __STDC_VERSION__ >= 201112L
#define {guard}_ALIGNED _Alignas({ALIGNMENT})
#else
#define {guard}_ALIGNED __attribute__((aligned({ALIGNMENT})))
#endif

enum {{ {name}_bytes = {count} }};

{guard}_ALIGNED static const unsigned char {name}[{count}] = {{\n"
    );
    for line in bytes.chunks(IN_A_LINE) {
        for byte in line {
            write!(text, "{byte},")?;
        }
        text.push('\n');
    }
    text.push_str("};\n\n#endif\n");
    Ok(text)
}
