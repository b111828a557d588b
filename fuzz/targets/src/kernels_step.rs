//! The calls of `observe_step` and `soft_step` on every kernel of this processor, and on several threads: after each call, and after each
//! step, all have the bits of the portable kernels.

use crate::structured::structured;
use crate::{observe_step, soft_step};
use arbitrary::Arbitrary;
use rigidformer_core::{Limits, Simulator, UnitId};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::kernels::Kernel;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::World;
use rigidformer_weights::AlignedBuffer;
use std::sync::LazyLock;

/// The portable kernels first.
static ENGINES: LazyLock<Vec<Engine>> = LazyLock::new(|| {
    let alone = |kernel| Engine { kernel, threads: Threads::ONE };
    let mut engines: Vec<Engine> = Kernel::available().into_iter().map(alone).collect();
    engines.extend(engines.last().map(|fastest| Engine { threads: Threads::all(), ..*fastest }));
    engines
});

fn loaded(models: &[AlignedBuffer]) -> Vec<LoadedModel> {
    models.iter().map(|model| LoadedModel::copy_of("fuzzed", model).expect("sound")).collect()
}

static RIGID: LazyLock<Vec<LoadedModel>> = LazyLock::new(|| loaded(&observe_step::MODELS));
static SOFT: LazyLock<Vec<LoadedModel>> = LazyLock::new(|| loaded(&soft_step::MODELS));

#[derive(Arbitrary, Debug)]
enum Calls {
    Rigid(u8, Vec<observe_step::Call>),
    Soft(u8, Vec<soft_step::Call>),
}

/// Makes the calls on a world for each engine. `steps` says how many steps a call stands for, none where it is of another kind.
fn compare<C>(
    (model, limits): (&LoadedModel, Limits),
    calls: &[C],
    steps: impl Fn(&C) -> Option<u8>,
    call: impl Fn(&mut Simulator<'_, '_>, &[UnitId], &C) -> bool,
) {
    let world = |engine: &Engine| World::on(*engine, model, limits, 1).expect("memory");
    let mut worlds: Vec<World> = ENGINES.iter().map(world).collect();
    let command = vec![0.25; model.model().config().command_size as usize];
    for world in &mut worlds {
        world.edit(|simulator| simulator.set_command(&command)).expect("a sound command");
    }
    let mut known = Vec::new();
    for next in calls {
        let repeats = steps(next);
        for _ in 0..repeats.unwrap_or(1) {
            known.extend(worlds[0].simulator().units().map(|unit| unit.id()));
            let mut outcomes = worlds.iter_mut().map(|world| {
                let done = match repeats {
                    Some(_) => world.step().is_ok(),
                    None => world.edit(|simulator| call(simulator, &known, next)),
                };
                (done, soft_step::everything(world.simulator()))
            });
            let portable = outcomes.next();
            for (outcome, engine) in outcomes.zip(&ENGINES[1..]) {
                assert_eq!(Some(outcome), portable, "{engine:?} has other bits");
            }
        }
    }
}

/// Makes the calls that an input stands for.
pub fn run(data: &[u8]) {
    match structured::<Calls>(data) {
        Some(Calls::Rigid(which, calls)) => {
            let model = &RIGID[usize::from(which) % RIGID.len()];
            let limits = Limits { units: 3, points: 24 };
            let steps = |call: &observe_step::Call| match call {
                observe_step::Call::Step(n) => Some(1 + n % 4),
                _ => None,
            };
            compare((model, limits), &calls[..calls.len().min(8)], steps, observe_step::call);
        }
        Some(Calls::Soft(which, calls)) => {
            let model = &SOFT[usize::from(which) % SOFT.len()];
            let limits = Limits { units: 4, points: 36 };
            let steps = |call: &soft_step::Call| match call {
                soft_step::Call::Step(n) => Some(1 + n % 4),
                _ => None,
            };
            compare((model, limits), &calls[..calls.len().min(6)], steps, soft_step::call);
        }
        None => {}
    }
}
