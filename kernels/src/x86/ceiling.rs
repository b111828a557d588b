//! The ceilings of int8 products: loops of nothing but the instructions that kernels multiply by.
#![allow(unsafe_code)]

use std::arch::asm;

/// Sums of a round on 512-bit registers.
// Each has a register of its own, so that none waits for another.
const SUMS: u64 = 24;
/// Sums of a round of `vpdpbusd` on 256-bit registers, of which there are 16.
const SUMS_OF_VNNI: u64 = 12;
/// Sums of a round on AVX2, each with a register for its product.
const SUMS_OF_BYTES: u64 = 6;

/// Rounds of `vpdpbusd` on 512-bit registers; multiply-accumulates a round.
pub(crate) fn avx512(rounds: u64) -> Option<u64> {
    super::Avx512Vnni::detect()?;
    if rounds > 0 {
        // SAFETY: the processor has AVX-512 VNNI, and all registers that are written are declared.
        unsafe {
            asm!(
                "2:",
                "vpdpbusd zmm0, zmm30, zmm31", "vpdpbusd zmm1, zmm30, zmm31", "vpdpbusd zmm2, zmm30, zmm31",
                "vpdpbusd zmm3, zmm30, zmm31", "vpdpbusd zmm4, zmm30, zmm31", "vpdpbusd zmm5, zmm30, zmm31",
                "vpdpbusd zmm6, zmm30, zmm31", "vpdpbusd zmm7, zmm30, zmm31", "vpdpbusd zmm8, zmm30, zmm31",
                "vpdpbusd zmm9, zmm30, zmm31", "vpdpbusd zmm10, zmm30, zmm31", "vpdpbusd zmm11, zmm30, zmm31",
                "vpdpbusd zmm12, zmm30, zmm31", "vpdpbusd zmm13, zmm30, zmm31", "vpdpbusd zmm14, zmm30, zmm31",
                "vpdpbusd zmm15, zmm30, zmm31", "vpdpbusd zmm16, zmm30, zmm31", "vpdpbusd zmm17, zmm30, zmm31",
                "vpdpbusd zmm18, zmm30, zmm31", "vpdpbusd zmm19, zmm30, zmm31", "vpdpbusd zmm20, zmm30, zmm31",
                "vpdpbusd zmm21, zmm30, zmm31", "vpdpbusd zmm22, zmm30, zmm31", "vpdpbusd zmm23, zmm30, zmm31",
                "dec {rounds}",
                "jnz 2b",
                rounds = inout(reg) rounds => _,
                out("zmm0") _, out("zmm1") _, out("zmm2") _, out("zmm3") _, out("zmm4") _, out("zmm5") _,
                out("zmm6") _, out("zmm7") _, out("zmm8") _, out("zmm9") _, out("zmm10") _, out("zmm11") _,
                out("zmm12") _, out("zmm13") _, out("zmm14") _, out("zmm15") _, out("zmm16") _, out("zmm17") _,
                out("zmm18") _, out("zmm19") _, out("zmm20") _, out("zmm21") _, out("zmm22") _, out("zmm23") _,
                options(nomem, nostack),
            );
        }
    }
    Some(SUMS * 64)
}

/// Rounds of `vpdpbusd` on 256-bit registers; multiply-accumulates a round.
pub(crate) fn avx_vnni(rounds: u64) -> Option<u64> {
    super::AvxVnni::detect()?;
    if rounds > 0 {
        // SAFETY: the processor has AVX-VNNI, and all registers that are written are declared.
        unsafe {
            asm!(
                "2:",
                "{{vex}} vpdpbusd ymm0, ymm14, ymm15", "{{vex}} vpdpbusd ymm1, ymm14, ymm15",
                "{{vex}} vpdpbusd ymm2, ymm14, ymm15", "{{vex}} vpdpbusd ymm3, ymm14, ymm15",
                "{{vex}} vpdpbusd ymm4, ymm14, ymm15", "{{vex}} vpdpbusd ymm5, ymm14, ymm15",
                "{{vex}} vpdpbusd ymm6, ymm14, ymm15", "{{vex}} vpdpbusd ymm7, ymm14, ymm15",
                "{{vex}} vpdpbusd ymm8, ymm14, ymm15", "{{vex}} vpdpbusd ymm9, ymm14, ymm15",
                "{{vex}} vpdpbusd ymm10, ymm14, ymm15", "{{vex}} vpdpbusd ymm11, ymm14, ymm15",
                "dec {rounds}",
                "jnz 2b",
                rounds = inout(reg) rounds => _,
                out("ymm0") _, out("ymm1") _, out("ymm2") _, out("ymm3") _, out("ymm4") _, out("ymm5") _,
                out("ymm6") _, out("ymm7") _, out("ymm8") _, out("ymm9") _, out("ymm10") _, out("ymm11") _,
                options(nomem, nostack),
            );
        }
    }
    Some(SUMS_OF_VNNI * 32)
}

/// Rounds of what AVX2 has for bytes: sign, product, widening and sum; multiply-accumulates a round.
pub(crate) fn avx2(rounds: u64) -> Option<u64> {
    super::Avx2::detect()?;
    if rounds > 0 {
        // SAFETY: the processor has AVX2, and all registers that are written are declared.
        unsafe {
            asm!(
                "2:",
                "vpxor ymm6, ymm12, ymm13", "vpmaddubsw ymm6, ymm14, ymm6", "vpmaddwd ymm6, ymm6, ymm15", "vpaddd ymm0, ymm0, ymm6",
                "vpxor ymm7, ymm12, ymm13", "vpmaddubsw ymm7, ymm14, ymm7", "vpmaddwd ymm7, ymm7, ymm15", "vpaddd ymm1, ymm1, ymm7",
                "vpxor ymm8, ymm12, ymm13", "vpmaddubsw ymm8, ymm14, ymm8", "vpmaddwd ymm8, ymm8, ymm15", "vpaddd ymm2, ymm2, ymm8",
                "vpxor ymm9, ymm12, ymm13", "vpmaddubsw ymm9, ymm14, ymm9", "vpmaddwd ymm9, ymm9, ymm15", "vpaddd ymm3, ymm3, ymm9",
                "vpxor ymm10, ymm12, ymm13", "vpmaddubsw ymm10, ymm14, ymm10", "vpmaddwd ymm10, ymm10, ymm15", "vpaddd ymm4, ymm4, ymm10",
                "vpxor ymm11, ymm12, ymm13", "vpmaddubsw ymm11, ymm14, ymm11", "vpmaddwd ymm11, ymm11, ymm15", "vpaddd ymm5, ymm5, ymm11",
                "dec {rounds}",
                "jnz 2b",
                rounds = inout(reg) rounds => _,
                out("ymm0") _, out("ymm1") _, out("ymm2") _, out("ymm3") _, out("ymm4") _, out("ymm5") _,
                out("ymm6") _, out("ymm7") _, out("ymm8") _, out("ymm9") _, out("ymm10") _, out("ymm11") _,
                options(nomem, nostack),
            );
        }
    }
    Some(SUMS_OF_BYTES * 32)
}
