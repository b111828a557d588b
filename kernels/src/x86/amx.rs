//! AMX: matrices of 16 rows of 64 bytes in registers, and their products.
//!
//! A tile of panels is [`Panels`](rigidformer_core::weights::Panels) as they lie in memory: 16 groups, each of them 16 channels by
//! four inputs. Sums are exact in i32, so that the bits are those of all other kernels.

use std::arch::asm;
use std::arch::x86_64::*;
use std::ops::Range;
use std::sync::OnceLock;

use rigidformer_core::weights::{PANEL, PANEL_DEPTH};

/// Bytes of a panel's group of inputs.
pub(super) const GROUP: usize = PANEL * PANEL_DEPTH;
/// Rows of a register.
const ROWS: usize = 16;
/// Bytes of a row.
const LINE: usize = 64;
/// Groups of inputs of a register.
const GROUPS_PER_REGISTER: usize = LINE / PANEL_DEPTH;
/// Multiply-accumulates, and groups of inputs, below which VNNI is faster.
// At 128 Ki AMX does 136 GMAC/s and VNNI 104; at 96 Ki 141 and 160 (docs/PERFORMANCE.md).
const MIN_WORK: usize = 128 << 10;
const MIN_GROUPS: usize = GROUPS_PER_REGISTER;
// A register of weights at the end of a panel reads into the next one, which must be as long.
const _: () = assert!(MIN_GROUPS >= GROUPS_PER_REGISTER);
/// Bytes of weights from which they come from memory, and are prefetched.
// They exceed the second-level cache, so each is read once, for all rows.
const MIN_MEMORY_BYTES: usize = 8 << 20;

/// Whether this processor has AMX, and the system grants it to this process. The request is made once.
pub(super) fn is_there() -> bool {
    static GRANTED: OnceLock<bool> = OnceLock::new();
    *GRANTED.get_or_init(|| has_instructions() && request_permission())
}

/// Whether the processor has AMX for int8, and the system keeps its registers.
fn has_instructions() -> bool {
    /// Leaf 1, ecx: `xgetbv` is available.
    const OSXSAVE: u32 = 1 << 27;
    /// Leaf 7, edx: AMX-TILE and AMX-INT8.
    const AMX: u32 = 1 << 24 | 1 << 25;
    /// State components of the system: configuration and data of tiles.
    const TILE_STATE: u64 = 1 << 17 | 1 << 18;
    // Older processors lack leaf 7, and without OSXSAVE `xgetbv` is undefined.
    if __cpuid(0).eax < 7 || __cpuid(1).ecx & OSXSAVE == 0 {
        return false;
    }
    // SAFETY: OSXSAVE says that the instruction is there.
    __cpuid_count(7, 0).edx & AMX == AMX && unsafe { enabled() } & TILE_STATE == TILE_STATE
}

/// State components that the system has enabled.
///
/// # Safety
/// The processor has `xgetbv`, which OSXSAVE says.
#[target_feature(enable = "xsave")]
unsafe fn enabled() -> u64 {
    // SAFETY: by this function's contract; register 0 is always there.
    unsafe { _xgetbv(0) }
}

/// Requests the tile registers from Linux, for this process and all its threads.
#[cfg(target_os = "linux")]
fn request_permission() -> bool {
    /// `ARCH_REQ_XCOMP_PERM` of asm/prctl.h.
    const REQUEST: libc::c_long = 0x1023;
    /// The state component of the tiles' data.
    const DATA: libc::c_long = 18;
    // SAFETY: takes two numbers and changes what this process may do, nothing in memory.
    unsafe { libc::syscall(libc::SYS_arch_prctl, REQUEST, DATA) == 0 }
}

/// Other systems have no such request.
#[cfg(not(target_os = "linux"))]
fn request_permission() -> bool {
    false
}

/// Whether AMX is faster for a product of so many rows, groups of inputs and channels.
pub(super) fn is_worth(rows: usize, groups: usize, channels: usize) -> bool {
    groups >= MIN_GROUPS && rows * groups * PANEL_DEPTH * channels >= MIN_WORK
}

/// A product of rows and panels.
#[derive(Clone, Copy)]
pub(super) struct Product<'a> {
    /// As many rows as `row_scales` has numbers, `row_bytes` apart, of which `groups * PANEL_DEPTH` bytes are activations with 128
    /// added.
    pub(super) x: *const i8,
    pub(super) row_bytes: usize,
    pub(super) row_scales: &'a [f32],
    pub(super) groups: usize,
    /// Whole panels for all channels, of `groups * GROUP` bytes each.
    pub(super) weights: &'a [i8],
    /// As many numbers as there are channels.
    pub(super) sums: &'a [i32],
    pub(super) scales: &'a [f32],
    /// Where biases are missing, zeros stand in.
    pub(super) bias: &'a [f32],
    /// First number of the first row, and numbers to the next. Each row has room for all channels, which nothing else overlaps.
    pub(super) out: *mut f32,
    pub(super) stride: usize,
}

/// What `ldtilecfg` reads.
#[repr(C, align(64))]
struct Shapes {
    palette: u8,
    start_row: u8,
    reserved: [u8; 14],
    line_bytes: [u16; 16],
    rows: [u8; 16],
}

impl Shapes {
    /// Sums in 0 to 3 and activations in 4 and 5, all of so many rows, and weights in 6 and 7.
    fn new(rows: usize) -> Self {
        let mut shapes = Shapes {
            palette: 1,
            start_row: 0,
            reserved: [0; 14],
            line_bytes: [0; 16],
            rows: [0; 16],
        };
        shapes.line_bytes[..8].fill(LINE as u16);
        shapes.rows[..6].fill(rows as u8);
        shapes.rows[6..8].fill(GROUPS_PER_REGISTER as u8);
        shapes
    }
}

/// Bytes of a register, where its lines begin at cache lines.
#[repr(C, align(64))]
struct Bytes([i8; ROWS * LINE]);

/// Numbers of the registers of sums.
#[repr(C, align(64))]
struct Sums([i32; 4 * ROWS * PANEL]);

/// Multiplies.
///
/// # Safety
/// [`is_there`] has said so, and the processor has AVX-512. The fields of `product` point to what they say; it has a row, a channel
/// and at least [`GROUPS_PER_REGISTER`] groups.
#[target_feature(enable = "avx512f")]
#[inline(never)]
pub(super) unsafe fn multiply(product: Product<'_>) {
    let Product { x, row_bytes, row_scales, groups, weights, .. } = product;
    let rows = row_scales.len();
    // All tiles have one height, so that the registers are configured once; the last ones may overlap.
    let tiles = rows.div_ceil(ROWS);
    let height = rows.div_ceil(tiles);
    let first_row = |tile: usize| (tile * height).min(rows - height);
    let shapes = Shapes::new(height);
    // SAFETY: the instruction is there by this function's contract, and `shapes` is as it demands.
    unsafe {
        asm!("ldtilecfg [{shapes}]", shapes = in(reg) &raw const shapes, options(nostack, readonly));
    }
    let panels = product.sums.len().div_ceil(PANEL);
    let (whole, rest) = (groups / GROUPS_PER_REGISTER, groups % GROUPS_PER_REGISTER);
    let mut tails = [const { Bytes([0; ROWS * LINE]) }; 2];
    let mut ends = [const { Bytes([0; ROWS * LINE]) }; 2];
    let mut sums = Sums([0; 4 * ROWS * PANEL]);
    // Weights in memory are read once, for all rows. Others are read for every two tiles, whose rows stay in the cache.
    let from_memory = weights.len() >= MIN_MEMORY_BYTES;
    let (pairs, strips) = (tiles.div_ceil(2), panels.div_ceil(2));
    for number in 0..pairs * strips {
        let (tile, panel) = match from_memory {
            true => (number % pairs * 2, number / pairs * 2),
            false => (number / strips * 2, number % strips * 2),
        };
        let tiles_here = if tile + 1 < tiles { 2 } else { 1 };
        let firsts = [tile, tile + tiles_here - 1].map(first_row);
        // The tails depend on the rows alone, so each pair of tiles copies them once where rows are the outer loop.
        if rest > 0 && (from_memory || panel == 0) {
            for (tail, first) in tails.iter_mut().zip(firsts) {
                for (row, line) in tail.0.chunks_exact_mut(LINE).enumerate().take(height) {
                    // SAFETY: the row is one of the product's, and `groups * PANEL_DEPTH` of its bytes are activations. Behind
                    // them the line stays 0, whatever the weights there are.
                    unsafe {
                        let from = x.add((first + row) * row_bytes + whole * LINE);
                        from.copy_to_nonoverlapping(line.as_mut_ptr(), rest * PANEL_DEPTH);
                    }
                }
            }
        }
        let panels_here = if panel + 1 < panels { 2 } else { 1 };
        let numbers = [panel, panel + panels_here - 1];
        // SAFETY: the panels are there, whole.
        let from = numbers.map(|panel| unsafe { weights.as_ptr().add(panel * groups * GROUP) });
        let mut tail_weights = from;
        if rest > 0 {
            for ((end, weights_of_tail), number) in
                ends.iter_mut().zip(&mut tail_weights).zip(numbers)
            {
                // SAFETY: `whole * GROUPS_PER_REGISTER` groups are of the panel, and `rest` behind them. A register reads more: of the next
                // panel, or of what was copied.
                unsafe {
                    *weights_of_tail = weights_of_tail.add(whole * GROUPS_PER_REGISTER * GROUP);
                    // Behind the last panel nothing may be read, so its tail is copied.
                    if number + 1 == panels {
                        weights_of_tail.copy_to_nonoverlapping(end.0.as_mut_ptr(), rest * GROUP);
                        *weights_of_tail = end.0.as_ptr();
                    }
                }
            }
        }
        let [one, other] = &tails;
        let tail = [one.0.as_ptr(), other.0.as_ptr(), tail_weights[0], tail_weights[1]];
        let operands = Operands {
            // SAFETY: the rows are there.
            x: firsts.map(|row| unsafe { x.add(row * row_bytes) }),
            row_bytes,
            weights: from,
            steps: whole,
            tail: if rest > 0 { tail.as_ptr() } else { std::ptr::null() },
            ahead: 2 * groups * GROUP,
        };
        // SAFETY: the registers have their shapes. At each step `height` rows and 16 groups are read, which are there, and at the
        // tail those of arrays that are as long. What is asked for ahead is not read, so that it may miss.
        unsafe {
            match from_memory && tile == 0 {
                true => operands.walk::<true>([tiles_here, panels_here], &mut sums),
                false => operands.walk::<false>([tiles_here, panels_here], &mut sums),
            }
        }
        for (quadrant, sums) in sums.0.chunks_exact(ROWS * PANEL).enumerate() {
            let (of_tile, of_panel) = (quadrant / 2, quadrant % 2);
            if of_tile < tiles_here && of_panel < panels_here {
                let rows = firsts[of_tile]..firsts[of_tile] + height;
                // SAFETY: rows and panel are those of the product.
                unsafe { finish(&product, rows, numbers[of_panel], sums) };
            }
        }
    }
    // SAFETY: the instruction is there by this function's contract. What the registers hold is not needed any more.
    unsafe { asm!("tilerelease", options(nostack, nomem)) };
}

/// Scales the sums of a panel's channels, a line a row, and writes them.
///
/// # Safety
/// The processor has AVX-512. The fields of `product` point to what they say; the rows are some of it, as many as `sums` has lines
/// or fewer, and the panel is one of it.
#[target_feature(enable = "avx512f")]
#[inline]
unsafe fn finish(product: &Product<'_>, rows: Range<usize>, panel: usize, sums: &[i32]) {
    let channels = product.sums.len();
    let first = panel * PANEL;
    let here = PANEL.min(channels - first);
    let mask = if here == PANEL { !0 } else { (1 << here) - 1 };
    let biases = PANEL.min(product.bias.len().saturating_sub(first));
    let of_bias = if biases == PANEL { mask } else { mask & ((1 << biases) - 1) };
    // SAFETY: the instructions by this function's contract. `here` numbers of `sums` and `scales` are read from `first` on, and of
    // `bias` those that are there; a line has a panel's numbers. The row of `out` has room for `here` numbers from `first` on.
    unsafe {
        let offset = _mm512_maskz_loadu_epi32(mask, product.sums.as_ptr().add(first));
        let start = _mm512_sub_epi32(_mm512_setzero_si512(), _mm512_slli_epi32::<7>(offset));
        let scales = _mm512_maskz_loadu_ps(mask, product.scales.as_ptr().add(first));
        let bias = product.bias.as_ptr().wrapping_add(first);
        let bias = _mm512_maskz_loadu_ps(of_bias, bias);
        let of_rows = &product.row_scales[rows.clone()];
        for ((row, line), scale) in rows.zip(sums.chunks_exact(PANEL)).zip(of_rows) {
            let sums = _mm512_add_epi32(start, _mm512_loadu_si512(line.as_ptr().cast()));
            let scale = _mm512_mul_ps(_mm512_set1_ps(*scale), scales);
            let x = _mm512_add_ps(_mm512_mul_ps(_mm512_cvtepi32_ps(sums), scale), bias);
            _mm512_mask_storeu_ps(product.out.add(row * product.stride + first), mask, x);
        }
    }
}

/// Addresses of the registers' operands, step by step.
struct Operands {
    /// Of the one and the other register of activations: where it begins, `row_bytes` from row to row, 64 bytes further at each step.
    x: [*const i8; 2],
    row_bytes: usize,
    /// Of the one and the other register of weights, which lie one behind the other.
    weights: [*const i8; 2],
    steps: usize,
    /// Null, or the same four addresses for a last step, with 64 bytes from row to row.
    tail: *const *const i8,
    /// Bytes to the weights that come next.
    ahead: usize,
}

impl Operands {
    /// The products of one or two registers of activations and as many of weights: (activations, weights, 16 lines, 16). `AHEAD` prefetches
    /// the weights of the next panels.
    ///
    /// # Safety
    /// The processor has AMX, and [`Shapes`] are set. As many lines as these say may be read at each step.
    #[inline(always)]
    unsafe fn walk<const AHEAD: bool>(self, parts: [usize; 2], sums: &mut Sums) {
        let Operands { x: [a, b], row_bytes, weights: [one, other], steps, tail, ahead } = self;
        /// One or two registers each: what a step does, and where sums go.
        macro_rules! walk {
            ([$($step:literal),*], [$($store:literal),*]) => {
                if AHEAD {
                    walk!([
                        $($step,)*
                        "prefetcht1 [{one} + {ahead}*1 + 0]", "prefetcht1 [{other} + {ahead}*1 + 0]",
                        "prefetcht1 [{one} + {ahead}*1 + 64]", "prefetcht1 [{other} + {ahead}*1 + 64]",
                        "prefetcht1 [{one} + {ahead}*1 + 128]", "prefetcht1 [{other} + {ahead}*1 + 128]",
                        "prefetcht1 [{one} + {ahead}*1 + 192]", "prefetcht1 [{other} + {ahead}*1 + 192]",
                        "prefetcht1 [{one} + {ahead}*1 + 256]", "prefetcht1 [{other} + {ahead}*1 + 256]",
                        "prefetcht1 [{one} + {ahead}*1 + 320]", "prefetcht1 [{other} + {ahead}*1 + 320]",
                        "prefetcht1 [{one} + {ahead}*1 + 384]", "prefetcht1 [{other} + {ahead}*1 + 384]",
                        "prefetcht1 [{one} + {ahead}*1 + 448]", "prefetcht1 [{other} + {ahead}*1 + 448]",
                        "prefetcht1 [{one} + {ahead}*1 + 512]", "prefetcht1 [{other} + {ahead}*1 + 512]",
                        "prefetcht1 [{one} + {ahead}*1 + 576]", "prefetcht1 [{other} + {ahead}*1 + 576]",
                        "prefetcht1 [{one} + {ahead}*1 + 640]", "prefetcht1 [{other} + {ahead}*1 + 640]",
                        "prefetcht1 [{one} + {ahead}*1 + 704]", "prefetcht1 [{other} + {ahead}*1 + 704]",
                        "prefetcht1 [{one} + {ahead}*1 + 768]", "prefetcht1 [{other} + {ahead}*1 + 768]",
                        "prefetcht1 [{one} + {ahead}*1 + 832]", "prefetcht1 [{other} + {ahead}*1 + 832]",
                        "prefetcht1 [{one} + {ahead}*1 + 896]", "prefetcht1 [{other} + {ahead}*1 + 896]",
                        "prefetcht1 [{one} + {ahead}*1 + 960]", "prefetcht1 [{other} + {ahead}*1 + 960]"
                    ] => [$($store),*])
                } else {
                    walk!(["/* {ahead} */", $($step),*] => [$($store),*])
                }
            };
            ([$($step:literal),*] => [$($store:literal),*]) => {
                asm!(
                    "tilezero tmm0", "tilezero tmm1", "tilezero tmm2", "tilezero tmm3",
                    "test {steps}, {steps}",
                    "jz 3f",
                    "2:",
                    $($step,)*
                    "add {a}, 64",
                    "add {b}, 64",
                    "add {one}, 1024",
                    "add {other}, 1024",
                    "dec {steps}",
                    "jnz 2b",
                    "3:",
                    "test {tail}, {tail}",
                    "jz 4f",
                    "mov {a}, [{tail}]",
                    "mov {b}, [{tail} + 8]",
                    "mov {one}, [{tail} + 16]",
                    "mov {other}, [{tail} + 24]",
                    "mov {row}, {line}",
                    "mov {steps}, 1",
                    "xor {tail}, {tail}",
                    "jmp 2b",
                    "4:",
                    $($store,)*
                    a = inout(reg) a => _,
                    b = inout(reg) b => _,
                    one = inout(reg) one => _,
                    other = inout(reg) other => _,
                    steps = inout(reg) steps => _,
                    row = inout(reg) row_bytes => _,
                    tail = inout(reg) tail => _,
                    line = in(reg) LINE,
                    ahead = in(reg) ahead,
                    to = in(reg) sums.0.as_mut_ptr(),
                    out("tmm0") _, out("tmm1") _, out("tmm2") _, out("tmm3") _,
                    out("tmm4") _, out("tmm5") _, out("tmm6") _, out("tmm7") _,
                    options(nostack),
                )
            };
        }
        // SAFETY: what is read is by this function's contract. Each register is written to a part of its own of `sums`, no more than
        // 16 lines of 64 bytes.
        unsafe {
            match parts {
                [2, 2] => walk!(
                    [
                        "tileloadd tmm4, [{a} + {row}*1]",
                        "tileloadd tmm6, [{one} + {line}*1]",
                        "tileloadd tmm7, [{other} + {line}*1]",
                        "tdpbusd tmm0, tmm4, tmm6",
                        "tileloadd tmm5, [{b} + {row}*1]",
                        "tdpbusd tmm1, tmm4, tmm7",
                        "tdpbusd tmm2, tmm5, tmm6",
                        "tdpbusd tmm3, tmm5, tmm7"
                    ],
                    [
                        "tilestored [{to} + {line}*1], tmm0",
                        "tilestored [{to} + {line}*1 + 1024], tmm1",
                        "tilestored [{to} + {line}*1 + 2048], tmm2",
                        "tilestored [{to} + {line}*1 + 3072], tmm3"
                    ]
                ),
                [2, _] => walk!(
                    [
                        "tileloadd tmm4, [{a} + {row}*1]",
                        "tileloadd tmm6, [{one} + {line}*1]",
                        "tdpbusd tmm0, tmm4, tmm6",
                        "tileloadd tmm5, [{b} + {row}*1]",
                        "tdpbusd tmm2, tmm5, tmm6"
                    ],
                    [
                        "tilestored [{to} + {line}*1], tmm0",
                        "tilestored [{to} + {line}*1 + 2048], tmm2"
                    ]
                ),
                [_, 2] => walk!(
                    [
                        "tileloadd tmm4, [{a} + {row}*1]",
                        "tileloadd tmm6, [{one} + {line}*1]",
                        "tileloadd tmm7, [{other} + {line}*1]",
                        "tdpbusd tmm0, tmm4, tmm6",
                        "tdpbusd tmm1, tmm4, tmm7"
                    ],
                    [
                        "tilestored [{to} + {line}*1], tmm0",
                        "tilestored [{to} + {line}*1 + 1024], tmm1"
                    ]
                ),
                _ => walk!(
                    [
                        "tileloadd tmm4, [{a} + {row}*1]",
                        "tileloadd tmm6, [{one} + {line}*1]",
                        "tdpbusd tmm0, tmm4, tmm6"
                    ],
                    ["tilestored [{to} + {line}*1], tmm0"]
                ),
            }
        }
    }
}
