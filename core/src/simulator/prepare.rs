//! The stage that a step begins with.

use super::state::Simulator;
use crate::error::StepError;
use crate::kernels::Schedule;
use crate::limits::MAX_COMMAND;
use crate::slices::{rows as rows_of, rows_mut};
use crate::structure::heading::{self, ROBOT, is_robot};
use crate::workspace::command_places;
use rigidformer_weights::Directions;

/// Room for a command as a heading has it.
const SEEN: usize = if ROBOT { MAX_COMMAND } else { 0 };

impl Simulator<'_, '_> {
    /// Refuses what cannot be stepped, and brings up to date what the network is told of the step as a whole.
    pub(super) fn prepare<S: Schedule>(&mut self, schedule: S) -> Result<(), StepError> {
        if self.scene.count == 0 {
            return Err(StepError::NoUnits);
        }
        if self.sizes.command > 0 && !self.commanded {
            return Err(StepError::NoCommand { size: self.sizes.command });
        }
        // The workspace was carved for one layout, and kernels of another would not fit it.
        if self.sizes.layout != S::LAYOUT {
            return Err(StepError::Layout);
        }
        if is_robot(self.model.config()) {
            heading::turn_frames(&mut self.scene);
        }
        self.modulate(schedule);
        Ok(())
    }

    /// Computes the modulations by the step code and the commands, where those have changed.
    fn modulate<S: Schedule>(&mut self, schedule: S) {
        let Self { model, sizes, scene, lasting, rows, .. } = self;
        let width = 2 * sizes.width;
        // They change with the time step alone, so most steps take those of the step before.
        if self.films_stale {
            let code = self.step_code / 10.0;
            let condition = [code, code * code];
            let films = core::iter::once(&model.encoder.film)
                .chain(model.blocks.iter().map(|block| &block.film))
                .chain(core::iter::once(&model.anchors.film));
            for (film, out) in films.zip(rows_mut(lasting.films, width)) {
                film.mlp.apply(schedule, &condition, rows.film_hidden, out, &mut rows.scratch);
            }
            self.films_stale = false;
        }
        // A direction in the world turns in the robot's frame as the robot does, in every step.
        let turned = ROBOT && model.config().directions != Directions::NONE;
        if self.commands_stale || turned {
            let places = command_places(sizes);
            let all = rows_mut(lasting.commands, places * width);
            let commands = rows_of(lasting.command_inputs, sizes.command);
            for ((copy, command), out) in commands.enumerate().zip(all) {
                let mut seen = [0.0; SEEN];
                let command = match scene.units().get(copy * scene.per_copy).filter(|_| turned) {
                    Some(unit) => heading::command(model.config(), unit, command, &mut seen),
                    None => command,
                };
                let films = core::iter::once(&model.encoder.command)
                    .chain(model.blocks.iter().map(|block| &block.command));
                for (film, out) in films.flatten().zip(rows_mut(out, width)) {
                    film.mlp.apply(schedule, command, rows.film_hidden, out, &mut rows.scratch);
                }
            }
            self.commands_stale = false;
        }
    }
}
