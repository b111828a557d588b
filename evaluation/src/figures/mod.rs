//! A split's figures: roll out every scene, compare, average.

mod scene;
mod split;

pub use scene::{
    FRAMES, Figures, GREATEST_STEP, LAST_FRAME, SceneFigures, free_falling, model,
    recorded_penetration,
};
pub use split::{
    SplitError, SplitFigures, TO_LAST_FRAME, apart_json, calls, evaluate, scenes_of,
    scenes_to_evaluate,
};
