//! `firmware MODEL rollout|contact|hostile|robot|walk|drape` prints what the image of that name must print about its rollouts, `firmware
//! MODEL roles|shatter` what the C programs of those names must print (`roles` is `push`), `firmware MODEL sizes` the sizes of the workspace;
//! `firmware contact` writes the points of the bodies that collide, `firmware drape` that of a sheet of cloth, `firmware walk SCENES` that of a robot, the first of a file that
//! `rigidformer_lab.g1` made.
#![allow(clippy::expect_used)]

use rigidformer_evaluation::scenes::Dataset;
use rigidformer_tests::firmware::{
    Bodies, TwoFrames, drape, drape_file, robot, roles, rollout, rollouts, shatter, walk,
    walk_file, workspace,
};
use rigidformer_weights::{AlignedBuffer, G1, SHELL};
use std::path::PathBuf;

fn scene(name: &str) -> PathBuf {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    root.join("../firmware-sim/firmware/scenes").join(name).with_extension("bin")
}

fn bodies() -> Bodies {
    Bodies::from_bytes(&std::fs::read(scene("bodies")).expect("the bodies"))
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let read = |name| TwoFrames::from_bytes(&std::fs::read(scene(name)).expect("the scene"));
    match arguments.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["contact"] => {
            let bytes = TwoFrames::of(&bodies()).to_bytes();
            std::fs::write(scene("contact"), bytes).expect("the folder can be written");
        }
        ["drape"] => {
            std::fs::write(scene("drape"), drape_file()).expect("the folder can be written");
        }
        ["walk", scenes] => {
            let scenes = Dataset::open(scenes.as_ref()).expect("scenes");
            let first = scenes.scene(0, None).expect("a scene");
            std::fs::write(scene("walk"), walk_file(&first, 10))
                .expect("the folder can be written");
        }
        [_, "walk"] => {
            print!("{}", walk(G1, &std::fs::read(scene("walk")).expect("the scene")));
        }
        [_, "drape"] => {
            print!("{}", drape(SHELL, &std::fs::read(scene("drape")).expect("the scene")));
        }
        [model, image] => {
            let model = AlignedBuffer::read(model.as_ref()).expect("the model");
            match *image {
                "sizes" => println!("{}", workspace(&model)),
                "rollout" => {
                    print!("{}", rollouts(&model, &bodies(), 100));
                }
                "contact" => print!("{}", rollout(&model, "contact", &read("contact"), 100)),
                "robot" => print!("{}", robot(&model)),
                "hostile" => print!("{}", rollout(&model, "contact", &read("contact"), 10)),
                "roles" => print!("{}", roles(&model)),
                "shatter" => print!("{}", shatter(&model)),
                _ => {}
            }
        }
        _ => eprintln!(
            "usage: firmware MODEL rollout|hostile|robot|walk|drape|roles|shatter|sizes, firmware contact, firmware drape, firmware walk SCENES"
        ),
    }
}
