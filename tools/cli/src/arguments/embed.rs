//! Arguments of `rigidformer embed`.

use std::path::PathBuf;

use clap::Args;

#[derive(Args)]
#[command(after_help = "\
The header defines NAME, an aligned array of constants that stays in flash, and NAME_bytes, its length: what rf_config takes
(docs/C.md). C11, C++11 and, with GCC or Clang, C99 compile it. Include it in one file. The model is checked first.

Examples:
  rigidformer embed nano.rfm --out model.h
  rigidformer embed tossed.rfm --name tossed --out tossed.h")]
pub(crate) struct Embed {
    /// Packed model
    #[arg(value_name = "MODEL")]
    pub(crate) model: PathBuf,
    /// Header to write
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,
    /// What the array is called
    #[arg(long, value_name = "NAME", default_value = "rf_model", value_parser = identifier)]
    pub(crate) name: String,
}

fn identifier(text: &str) -> Result<String, String> {
    let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_';
    if text.starts_with(|c: char| c.is_ascii_alphabetic()) && text.chars().all(is_word) {
        Ok(text.to_owned())
    } else {
        Err("is no name in C; give letters, digits and _, a letter first".into())
    }
}
