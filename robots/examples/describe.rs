//! Prints what a robot is made of, as JSON.
//!
//! ```sh
//! cargo run --release -p rigidformer-robots --example describe -- robot.urdf
//! ```

use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut options = rigidformer_robots::LoadOptions::default();
    let mut files = Vec::new();
    for word in std::env::args().skip(1) {
        match word.as_str() {
            "--balance" => options.balance_inertia = true,
            "--skip-meshes" => options.skip_missing_meshes = true,
            "--merge-fixed" => options.merge_fixed = true,
            _ => files.push(word),
        }
    }
    for file in files {
        let robot = rigidformer_robots::load_robot_with(Path::new(&file), &options)?;
        println!("{}", robot.describe()?);
    }
    Ok(())
}
