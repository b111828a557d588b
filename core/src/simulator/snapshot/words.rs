//! A snapshot as words of 32 bits, least byte first, and their checksum.

use crate::geometry::{COURSE, Course, POSE, Pose, read_pose, write_pose};
use core::ops::Range;
use nalgebra::Vector3;

/// Bytes of a word.
pub(super) const WORD: usize = 4;

/// FNV-1a over words: each step can be undone, so no single word changes without it.
#[derive(Clone, Copy)]
pub(super) struct Hash(u64);

impl Hash {
    pub(super) const NEW: Hash = Hash(0xcbf2_9ce4_8422_2325);

    pub(super) fn add(&mut self, word: u32) {
        self.0 = (self.0 ^ u64::from(word)).wrapping_mul(0x0100_0000_01b3);
    }

    pub(super) fn number(self) -> u64 {
        self.0
    }
}

/// Where the words of a snapshot go.
pub(super) trait Sink {
    fn word(&mut self, word: u32);

    fn words<const N: usize>(&mut self, words: [u32; N]) {
        for word in words {
            self.word(word);
        }
    }

    /// A number of 64 bits.
    fn long(&mut self, number: u64) {
        // The halves, the lower one first.
        self.words([number as u32, (number >> 32) as u32]);
    }

    fn number(&mut self, number: f32) {
        self.word(number.to_bits());
    }

    fn numbers<const N: usize>(&mut self, numbers: [f32; N]) {
        self.words(numbers.map(f32::to_bits));
    }

    fn vector(&mut self, v: &Vector3<f32>) {
        self.numbers([v.x, v.y, v.z]);
    }

    fn pose(&mut self, pose: &Pose) {
        let mut row = [0.0; POSE];
        write_pose(pose, &mut row);
        self.numbers(row);
    }
}

/// Counts words.
pub(super) struct Count(pub(super) usize);

impl Sink for Count {
    fn word(&mut self, _: u32) {
        self.0 = self.0.saturating_add(1);
    }
}

/// Writes words to bytes, as far as there is room, and hashes them.
pub(super) struct Writer<'b> {
    rest: &'b mut [u8],
    pub(super) hash: Hash,
}

impl<'b> Writer<'b> {
    pub(super) fn new(bytes: &'b mut [u8]) -> Self {
        Writer { rest: bytes, hash: Hash::NEW }
    }
}

impl Sink for Writer<'_> {
    fn word(&mut self, word: u32) {
        self.hash.add(word);
        if let Some((place, rest)) = core::mem::take(&mut self.rest).split_first_chunk_mut() {
            *place = word.to_le_bytes();
            self.rest = rest;
        }
    }
}

/// Compares words with those of a snapshot, from one on.
pub(super) struct Compare<'b> {
    pub(super) words: Words<'b>,
    pub(super) at: usize,
    pub(super) is_same: bool,
}

impl Sink for Compare<'_> {
    fn word(&mut self, word: u32) {
        self.is_same &= self.words.word(self.at) == word;
        self.at = self.at.saturating_add(1);
    }
}

/// The words of a snapshot.
#[derive(Clone, Copy)]
pub(super) struct Words<'b>(&'b [[u8; WORD]]);

impl<'b> Words<'b> {
    /// Of bytes that are whole words.
    pub(super) fn new(bytes: &'b [u8]) -> Option<Self> {
        let (words, rest) = bytes.as_chunks();
        rest.is_empty().then_some(Words(words))
    }

    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    /// A word; 0 behind the last.
    pub(super) fn word(&self, at: usize) -> u32 {
        self.0.get(at).map_or(0, |word| u32::from_le_bytes(*word))
    }

    /// A word that counts something.
    pub(super) fn count(&self, at: usize) -> usize {
        self.word(at) as usize
    }

    pub(super) fn long(&self, at: usize) -> u64 {
        u64::from(self.word(at)) | u64::from(self.word(at + 1)) << 32
    }

    pub(super) fn number(&self, at: usize) -> f32 {
        f32::from_bits(self.word(at))
    }

    pub(super) fn vector(&self, at: usize) -> Vector3<f32> {
        let [x, y, z] = [at, at + 1, at + 2].map(|at| self.number(at));
        Vector3::new(x, y, z)
    }

    pub(super) fn pose(&self, at: usize) -> Pose {
        read_pose(&self.row::<POSE>(at))
    }

    pub(super) fn course(&self, at: usize) -> Course {
        Course::read(&self.row::<COURSE>(at))
    }

    fn row<const N: usize>(&self, at: usize) -> [f32; N] {
        core::array::from_fn(|place| self.number(at + place))
    }

    /// The first of some words that is not a number within a limit.
    pub(super) fn first_beyond(&self, range: Range<usize>, limit: f32) -> Option<usize> {
        // A NaN compares as not within it.
        let is_within = |at: usize| self.number(at).abs() <= limit;
        range.into_iter().find(|at| !is_within(*at))
    }

    /// The hash of the first words.
    pub(super) fn hash(&self, count: usize) -> Hash {
        let mut hash = Hash::NEW;
        for word in self.0.iter().take(count) {
            hash.add(u32::from_le_bytes(*word));
        }
        hash
    }
}
