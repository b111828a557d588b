//! Every damaged or crafted file is refused with a typed error, and none makes the reader panic.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, unreachable_pub)]

use crate::common::{Entry, Header, Random, crc32, error, f32_bytes, file, repair, varint, visit};
use rigidformer_weights::{
    Aligned, AlignedBuffer, ConfigError, FormatError, MAX_TENSORS, ModelConfig, ModelFile, Section,
    VERSION, include_model,
};

static TINY: &Aligned<[u8]> = include_model!("../data/tiny.rfm");

/// A payload of one cache line: sixteen ones.
fn ones() -> Vec<u8> {
    f32_bytes(&[1.0; 16])
}

#[test]
fn every_cut_is_refused() {
    for length in 0..TINY.len() {
        match error(&TINY[..length]) {
            FormatError::Truncated { expected, found } => {
                assert!(found == length as u64 && expected > found)
            }
            other => panic!("{length}: {other}"),
        }
    }
}

#[test]
fn appended_bytes_are_refused() {
    let long = [&TINY[..], &[0]].concat();
    let length = TINY.len() as u64;
    assert_eq!(error(&long), FormatError::TrailingBytes { expected: length, found: length + 1 });
}

#[test]
fn every_changed_byte_is_refused() {
    let mut bytes = TINY.to_vec();
    for at in 0..bytes.len() {
        for flip in 1..=255 {
            bytes[at] ^= flip;
            error(&bytes);
            bytes[at] ^= flip;
        }
    }
}

#[test]
fn each_section_names_itself() {
    for (at, section) in
        [(40, Section::Prefix), (70, Section::Header), (TINY.len() - 300, Section::Payload)]
    {
        let mut bytes = TINY.to_vec();
        bytes[at] ^= 4;
        assert!(
            matches!(error(&bytes), FormatError::Checksum { section: found, .. } if found == section)
        );
    }
}

#[test]
fn foreign_files_are_named() {
    let zip = b"PK\x03\x04\x14\x00\x00\x00\x08\x00";
    assert_eq!(error(zip), FormatError::NotAModel { found: *b"PK\x03\x04\x14\x00\x00\x00" });
    let safetensors = b"\x40\x00\x00\x00\x00\x00\x00\x00{\"a\":{\"dtype\":\"F32\"}}";
    assert!(matches!(error(safetensors), FormatError::NotAModel { .. }));
    assert_eq!(error(b"GIF"), FormatError::NotAModel { found: *b"GIF\0\0\0\0\0" });
    assert_eq!(error(b""), FormatError::Truncated { expected: 64, found: 0 });
    // Git's stand-in for a large file.
    assert!(matches!(error(b"version https"), FormatError::NotAModel { .. }));
}

#[test]
fn other_versions_are_named() {
    for version in [0, VERSION + 1, u32::MAX] {
        let mut bytes = TINY.to_vec();
        bytes[8..12].copy_from_slice(&version.to_le_bytes());
        assert_eq!(error(&bytes), FormatError::Version { found: version, supported: VERSION });
        assert!(repair(&mut bytes));
        assert_eq!(error(&bytes), FormatError::Version { found: version, supported: VERSION });
    }
}

#[test]
fn misaligned_bytes_are_refused() {
    let shifted = AlignedBuffer::copy_of(&[&[0], &TINY[..]].concat());
    assert_eq!(
        ModelFile::parse(&shifted[1..]).unwrap_err(),
        FormatError::Misaligned { remainder: 1 }
    );
    for by in [16, 32, 48] {
        let shifted = AlignedBuffer::copy_of(&[&vec![0; by], &TINY[..]].concat());
        visit(&ModelFile::parse(&shifted[by..]).unwrap());
    }
}

#[test]
fn lengths_in_the_prefix_are_checked() {
    let patched = |at: usize, value: &[u8]| {
        let mut bytes = TINY.to_vec();
        bytes[at..at + value.len()].copy_from_slice(value);
        let crc = crc32(&bytes[..60]).to_le_bytes();
        bytes[60..64].copy_from_slice(&crc);
        error(&bytes)
    };
    for header_length in [0, u32::MAX, 1 << 20] {
        assert!(matches!(
            patched(12, &header_length.to_le_bytes()),
            FormatError::PayloadOffset { .. }
        ));
    }
    for offset in [0, 1, 64, u64::MAX, u64::MAX - 63, 1 << 63] {
        assert!(matches!(patched(16, &offset.to_le_bytes()), FormatError::PayloadOffset { .. }));
    }
    for length in [u64::MAX, u64::MAX - 63, 1 << 40] {
        assert!(matches!(patched(24, &length.to_le_bytes()), FormatError::Truncated { .. }));
    }
    assert!(matches!(patched(24, &0u64.to_le_bytes()), FormatError::TrailingBytes { .. }));
    assert_eq!(patched(59, &[1]), FormatError::Padding { section: Section::Prefix });
}

#[test]
fn padding_must_be_zero() {
    let mut after_header = file(&Header::new(vec![]).encode(), &[]);
    *after_header.last_mut().unwrap() = 1;
    assert_eq!(error(&after_header), FormatError::Padding { section: Section::Header });
    let mut payload = f32_bytes(&[1.0]);
    payload[63] = 1;
    let after_tensor = file(&Header::new(vec![Entry::f32("a", 1, 0)]).encode(), &payload);
    assert_eq!(error(&after_tensor), FormatError::Padding { section: Section::Payload });
}

#[test]
fn tensors_have_one_place_each() {
    let case = |entries: &[Entry], lines: usize| {
        error(&file(&Header::new(entries.to_vec()).encode(), &ones().repeat(lines)))
    };
    let (a, b) = (Entry::f32("a", 16, 0), Entry::f32("b", 16, 64));
    let b_at = |offset| Entry { offset, ..b.clone() };
    assert_eq!(
        case(&[a.clone(), b_at(0)], 2),
        FormatError::Overlap { tensor: 1, free: 64, found: 0 }
    );
    assert_eq!(
        case(&[a.clone(), b_at(60)], 2),
        FormatError::Overlap { tensor: 1, free: 64, found: 60 }
    );
    assert_eq!(
        case(&[a.clone(), b_at(68)], 3),
        FormatError::Gap { tensor: 1, free: 64, found: 68 }
    );
    assert_eq!(
        case(&[a.clone(), b_at(128)], 3),
        FormatError::Gap { tensor: 1, free: 64, found: 128 }
    );
    assert_eq!(
        case(&[a.clone(), b_at(u64::MAX)], 2),
        FormatError::Gap { tensor: 1, free: 64, found: u64::MAX }
    );
    assert_eq!(
        case(&[a.clone(), b.clone()], 1),
        FormatError::Beyond { tensor: 1, payload_length: 64 }
    );
    assert_eq!(
        case(&[a.clone(), b.clone()], 3),
        FormatError::Unclaimed { expected: 128, found: 192 }
    );
    assert_eq!(
        case(&[b_at(0), Entry { offset: 64, ..a.clone() }], 2),
        FormatError::Order { tensor: 1 }
    );
    assert_eq!(
        case(&[a.clone(), Entry { name: "a".into(), ..b.clone() }], 2),
        FormatError::Order { tensor: 1 }
    );
    let scales_inside = Entry::i8("a", 4, 16, 0, 0);
    assert_eq!(case(&[scales_inside], 2), FormatError::Overlap { tensor: 0, free: 64, found: 0 });
    let scales_far = Entry::i8("a", 4, 16, 0, u64::MAX - 1);
    assert!(matches!(case(&[scales_far], 2), FormatError::Gap { tensor: 0, .. }));
}

#[test]
fn shapes_types_and_lengths_agree() {
    let case = |entry: Entry| error(&file(&Header::new(vec![entry]).encode(), &ones()));
    let good = Entry::f32("a", 16, 0);
    assert_eq!(
        case(Entry { byte_length: 60, ..good.clone() }),
        FormatError::Size { tensor: 0, expected: 64, found: 60 }
    );
    assert_eq!(
        case(Entry { dtype: 1, ..good.clone() }),
        FormatError::Size { tensor: 0, expected: 32, found: 64 }
    );
    let huge = Entry { shape: vec![u32::MAX, u32::MAX], byte_length: u64::MAX, ..good.clone() };
    assert_eq!(case(huge.clone()), FormatError::Shape { tensor: 0 });
    let large =
        Entry { dtype: 2, byte_length: u64::from(u32::MAX).pow(2), scales_offset: Some(0), ..huge };
    assert_eq!(case(large), FormatError::Beyond { tensor: 0, payload_length: 64 });
    assert_eq!(
        case(Entry { shape: vec![0, 16], byte_length: 0, ..good.clone() }),
        FormatError::Shape { tensor: 0 }
    );
    let vector = Entry { dtype: 2, shape: vec![64], scales_offset: Some(64), ..good.clone() };
    assert_eq!(case(vector), FormatError::Shape { tensor: 0 });
    assert_eq!(
        case(Entry { scales_offset: Some(64), ..good.clone() }),
        FormatError::ScalesOffset { tensor: 0 }
    );
    let bare = Entry { scales_offset: None, ..Entry::i8("a", 4, 16, 0, 0) };
    assert_eq!(case(bare), FormatError::ScalesOffset { tensor: 0 });
    assert!(matches!(
        case(Entry { dtype: 4, ..good.clone() }),
        FormatError::Header { field: "tensors", .. }
    ));
    let rank = Entry { shape: vec![1, 2, 8], ..good };
    assert!(matches!(case(rank), FormatError::Header { field: "tensors", .. }));
}

#[test]
fn values_are_finite() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut values = [1.0; 16];
        values[5] = bad;
        let bytes = file(&Header::new(vec![Entry::f32("a", 16, 0)]).encode(), &f32_bytes(&values));
        assert_eq!(error(&bytes), FormatError::NotFinite { tensor: 0, element: 5 });
    }
    for bad in [0x7c00u16, 0xfc00, 0x7e01] {
        let mut payload = vec![0; 64];
        payload[6..8].copy_from_slice(&bad.to_le_bytes());
        let entry = Entry { dtype: 1, byte_length: 32, ..Entry::f32("a", 16, 0) };
        let bytes = file(&Header::new(vec![entry]).encode(), &payload);
        assert_eq!(error(&bytes), FormatError::NotFinite { tensor: 0, element: 3 });
    }
    for bad in [0.0, -0.0, -1.0, f32::NAN, f32::INFINITY] {
        let payload = [vec![1; 64], f32_bytes(&[1.0, bad])].concat();
        let bytes = file(&Header::new(vec![Entry::i8("a", 2, 32, 0, 64)]).encode(), &payload);
        assert_eq!(error(&bytes), FormatError::Scale { tensor: 0, channel: 1 });
    }
    let metric =
        Header { metrics: vec![("a".into(), 0.0), ("b".into(), f32::NAN)], ..Header::new(vec![]) };
    assert_eq!(error(&file(&metric.encode(), &[])), FormatError::Metric { index: 1 });
}

#[test]
fn configurations_stay_within_their_limits() {
    let tiny = ModelConfig::TINY;
    let cases = [
        (ModelConfig { width: 0, ..tiny }, "`width` is 0; a model has 1 to 16384"),
        (ModelConfig { heads: 257, ..tiny }, "`heads` is 257; a model has 1 to 256"),
        (
            ModelConfig { head_dim: 13, ..tiny },
            "`head_dim` is 13; rotations turn pairs of channels, so it must be even",
        ),
        (ModelConfig { head_dim: 0, ..tiny }, "`head_dim` is 0; a model has 2 to 1024"),
        (ModelConfig { blocks: 33, ..tiny }, "`blocks` is 33; a model has 1 to 32"),
        (
            ModelConfig { point_width: u32::MAX, ..tiny },
            "`point_width` is 4294967295; a model has 1 to 16384",
        ),
        (ModelConfig { registers: 1025, ..tiny }, "`registers` is 1025; a model has 0 to 1024"),
        (
            ModelConfig { feed_forward_width: 0, ..tiny },
            "`feed_forward_width` is 0; a model has 1 to 16384",
        ),
        (ModelConfig { avp_width: 0, ..tiny }, "`avp_width` is 0; a model has 1 to 16384"),
        (ModelConfig { film_width: 0, ..tiny }, "`film_width` is 0; a model has 1 to 16384"),
        (
            ModelConfig { command_size: 1025, ..tiny },
            "`command_size` is 1025; a model has 0 to 1024",
        ),
        (
            ModelConfig { rope_frequencies: u32::MAX, ..tiny },
            "`rope_frequencies` is 4294967295; six channels each do not fit into a `head_dim` of 12",
        ),
        (
            ModelConfig { scales: rigidformer_weights::Scales(0), ..tiny },
            "`scales` is empty; anchors need at least one level to attend to, such as 0",
        ),
        (
            ModelConfig { scales: rigidformer_weights::Scales::new(&[0, 3]), ..tiny },
            "`scales` names level 3 of a model with 2 blocks",
        ),
        (
            ModelConfig { output_scale: 0.0, ..tiny },
            "`output_scale` is 0; a model has 0.000001 to 1000000",
        ),
        (
            ModelConfig { frame_rate_hz: f32::NAN, ..tiny },
            "`frame_rate_hz` is NaN; a model has 0.001 to 1000000",
        ),
        (
            ModelConfig { frame_rate_hz: 0.0, ..tiny },
            "`frame_rate_hz` is 0; a model has 0.001 to 1000000",
        ),
        (
            ModelConfig { gravity_m_s2: [0.0, f32::INFINITY, 0.0], ..tiny },
            "`gravity_m_s2` is inf; a model has -10000 to 10000",
        ),
        (
            ModelConfig { ground_friction: -0.1, ..tiny },
            "`ground_friction` is -0.1; a model has 0 to 1000",
        ),
        (
            ModelConfig { ground_restitution: f32::NEG_INFINITY, ..tiny },
            "`ground_restitution` is -inf; a model has 0 to 1000",
        ),
    ];
    for (config, message) in cases {
        let expected: ConfigError = config.validate().unwrap_err();
        assert_eq!(expected.to_string(), message);
        let found = error(&file(&Header { config, ..Header::new(vec![]) }.encode(), &[]));
        assert_eq!(found.to_string(), format!("configuration: {message}"));
        // NaN is not equal to itself.
        assert!(
            matches!(found, FormatError::Config(found) if found.to_string() == expected.to_string())
        );
    }
}

#[test]
fn texts_do_not_steer_a_terminal() {
    let long = "x".repeat(257);
    for bad in ["", "\u{1b}[2J", "a\nb", "\u{85}", &long] {
        let name = Header { name: bad.into(), ..Header::new(vec![]) };
        assert_eq!(
            error(&file(&name.encode(), &[])),
            FormatError::Text { field: "model name", index: 0 }
        );
        let tensor = Header::new(vec![Entry::f32(bad, 16, 0)]);
        assert_eq!(
            error(&file(&tensor.encode(), &ones())),
            FormatError::Text { field: "tensor name", index: 0 }
        );
        let metric = Header { metrics: vec![(bad.into(), 1.0)], ..Header::new(vec![]) };
        assert_eq!(
            error(&file(&metric.encode(), &[])),
            FormatError::Text { field: "metric", index: 0 }
        );
        let key = Header { provenance: vec![(bad.into(), String::new())], ..Header::new(vec![]) };
        assert_eq!(
            error(&file(&key.encode(), &[])),
            FormatError::Text { field: "provenance key", index: 0 }
        );
    }
    let value = Header { provenance: vec![("key".into(), "\u{1b}".into())], ..Header::new(vec![]) };
    assert_eq!(
        error(&file(&value.encode(), &[])),
        FormatError::Text { field: "provenance value", index: 0 }
    );
    let lines = Header {
        provenance: vec![("key".into(), format!("two\nlines\t{long}"))],
        ..Header::new(vec![])
    };
    visit(&ModelFile::parse(&AlignedBuffer::copy_of(&file(&lines.encode(), &[]))).unwrap());
}

#[test]
fn hostile_headers_are_refused() {
    let front = Header::new(vec![]).encode();
    let front = &front[..front.len() - 3];
    let header = |tail: &[&[u8]]| error(&file(&[front, &tail.concat()].concat(), &[]));
    let decodes_not = |error: FormatError, field: &str| match error {
        FormatError::Header { field: found, .. } => assert_eq!(found, field),
        other => panic!("{other}"),
    };
    // Counts that nothing follows, and counts that do not fit into 32 bits.
    for count in
        [varint(1), varint(u64::from(u32::MAX)), varint(u64::MAX), vec![0x80; 40], vec![0xff; 11]]
    {
        decodes_not(header(&[&count]), "provenance");
        decodes_not(header(&[&[0], &count]), "metrics");
    }
    let found = MAX_TENSORS + 1;
    assert_eq!(
        header(&[&[0, 0], &varint(u64::from(found))]),
        FormatError::TooManyTensors { found, maximum: MAX_TENSORS }
    );
    decodes_not(header(&[&[0, 0], &varint(u64::from(MAX_TENSORS))]), "tensors");
    // Strings longer than the header, as long as the address space, and not UTF-8.
    for length in [varint(5), varint(u64::from(u32::MAX)), varint(u64::MAX), varint(u64::MAX / 2)] {
        decodes_not(header(&[&[1], &length]), "provenance");
        decodes_not(header(&[&[0, 0, 1], &length]), "tensors");
    }
    decodes_not(header(&[&[1, 1, 0xff, 0]]), "provenance");
    // An option that is neither none nor some, an unknown dtype, an offset of more than 64 bits.
    let entry: &[u8] = &[0, 0, 1, 1, b'a', 0, 1, 16, 0, 64];
    decodes_not(header(&[entry, &[2]]), "tensors");
    decodes_not(header(&[&[0, 0, 1, 1, b'a'], &varint(1 << 32)]), "tensors");
    decodes_not(header(&[&entry[..8], &[0xff; 9], &[0x7f], &[64, 0]]), "tensors");
    // Bytes after the end, and nothing at all.
    decodes_not(header(&[&[0, 0, 0], &[0]]), "end of the header");
    decodes_not(error(&file(&[], &[])), "name");
    decodes_not(error(&file(&front[..10], &[])), "config");
}

#[test]
fn the_most_tensors_are_accepted() {
    let entries = |count: u32| {
        (0..count).map(|i| Entry::f32(&format!("{i:05}"), 16, u64::from(i) * 64)).collect()
    };
    let bytes =
        file(&Header::new(entries(MAX_TENSORS)).encode(), &ones().repeat(MAX_TENSORS as usize));
    let bytes = AlignedBuffer::copy_of(&bytes);
    let model = ModelFile::parse(&bytes).unwrap();
    assert_eq!(model.tensors().len(), MAX_TENSORS as usize);
    assert_eq!(model.parameters(), u64::from(MAX_TENSORS) * 16);
}

/// Changes bytes and lengths anywhere, half of the time with checksums that fit again: either a
/// model that can be read through, or an error.
#[test]
fn mutations_never_panic() {
    let mut random = Random(1);
    let (mut accepted, mut deep) = (0, 0);
    for round in 0..10_000 {
        let mut bytes = TINY.to_vec();
        for _ in 0..=random.below(4) {
            let end = if round % 4 == 0 { bytes.len() } else { bytes.len().min(400) };
            let at = random.below(end);
            match random.below(5) {
                0 => bytes[at] = random.below(256) as u8,
                1 => bytes[at] ^= 1 << random.below(8),
                2 => bytes[at] = [0, 1, 0x7f, 0x80, 0xff][random.below(5)],
                3 => drop(bytes.drain(at..(at + random.below(9)).min(end))),
                _ => drop(bytes.splice(at..at, [0xff, 0, 0x80][..random.below(4)].to_vec())),
            }
        }
        let repaired = round % 2 == 0 && repair(&mut bytes);
        match ModelFile::parse(&AlignedBuffer::copy_of(&bytes)) {
            Ok(model) => {
                visit(&model);
                accepted += 1;
            }
            Err(error) => deep += usize::from(repaired && !error.to_string().contains("checksum")),
        }
    }
    // The loop reaches behind the checksums, in both directions.
    assert!(
        accepted > 100 && deep > 1000,
        "{accepted} accepted, {deep} refused behind the checksums"
    );
}
