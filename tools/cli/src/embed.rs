//! `rigidformer embed`

use std::fmt::Write;

use rigidformer_runtime::core::weights::MAGIC;
use rigidformer_runtime::files::read_whole;
use rigidformer_runtime::models::LoadedModel;

use crate::arguments::Embed;
use crate::output;

/// Bytes in a line of the header.
const IN_A_LINE: usize = 24;
/// What the runtime asks of a model's address.
const ALIGNMENT: usize = 16;

pub(crate) fn run(arguments: &Embed) -> anyhow::Result<()> {
    let shown = arguments.model.display();
    output::apart("--out", &arguments.out, [arguments.model.as_path()])?;
    let bytes = read_whole(&arguments.model)?;
    if !bytes.starts_with(&MAGIC) {
        anyhow::bail!("{shown}: is no packed model; pack it first with `rigidformer pack`");
    }
    let loaded = LoadedModel::copy_of(&arguments.model, &bytes)?;
    let crc = loaded.model().file().payload_crc();
    let text = header(&arguments.name, &bytes, crc)?;
    output::write_whole(&arguments.out, text.as_bytes())?;
    output::line(format_args!(
        "{}: {} of {} bytes, aligned to {ALIGNMENT}, weights CRC-32 {crc:08x}",
        arguments.out.display(),
        arguments.name,
        bytes.len()
    ))
}

fn header(name: &str, bytes: &[u8], crc: u32) -> Result<String, std::fmt::Error> {
    let (guard, count) = (name.to_ascii_uppercase(), bytes.len());
    let mut text = format!(
        "/* A packed RigidFormer model, weights CRC-32 {crc:08x}; written by `rigidformer embed`. */
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
