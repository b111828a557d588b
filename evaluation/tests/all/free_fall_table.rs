//! The free-fall rows of the published-split table, from the regenerated scenes: `RIGIDFORMER_DATA` names their folder.

use std::path::PathBuf;

use rigidformer_evaluation::figures::{self, FRAMES};
use rigidformer_evaluation::scenes::{Dataset, Split};

/// (position m, orientation degrees) at frames 50, 75 and 100.
const EXPECTED: [(&str, [(f64, f64); 3]); 3] = [
    ("movi-a", [(0.082, 5.30), (0.188, 11.31), (0.330, 17.69)]),
    ("movi-b", [(0.069, 4.27), (0.150, 9.09), (0.270, 16.33)]),
    ("movi-sphere", [(0.085, 3.89), (0.194, 7.91), (0.343, 13.31)]),
];

#[test]
fn free_fall_rows_are_reproduced() {
    let Some(folder) = std::env::var_os("RIGIDFORMER_DATA").map(PathBuf::from) else {
        eprintln!(
            "SKIPPED: set RIGIDFORMER_DATA to the folder of movi-a.safetensors, movi-b and movi-sphere"
        );
        return;
    };
    for (name, rows) in EXPECTED {
        let path = folder.join(format!("{name}.safetensors"));
        let dataset = Dataset::open(&path).unwrap_or_else(|error| panic!("{error}"));
        let test = dataset.scenes_of(Split::Test);
        assert_eq!(test.len(), 120, "{name}: scenes of the test split");
        let scenes: Vec<_> =
            test.iter().map(|index| dataset.scene(*index, Some(101)).unwrap()).collect();
        let figures = figures::free_falling(&scenes).unwrap();
        println!("{name}: {figures:?}");
        for ((found, (position, orientation)), frame) in figures.errors.iter().zip(rows).zip(FRAMES)
        {
            assert!(
                (found.position_m - position).abs() < 0.000_51,
                "{name} frame {frame}: {found:?}"
            );
            assert!(
                (found.orientation_rms_deg - orientation).abs() < 0.005_1,
                "{name} frame {frame}: {found:?}"
            );
        }
        assert!(figures.rigidity < 1e-4, "{name}: {}", figures.rigidity);
    }
}
