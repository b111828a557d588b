//! The world: PyBullet in a process of its own (`rigidformer_lab.push_world`), a request and an
//! answer a line.

use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::{Physics, Plane};
use rigidformer_planning::planner::Cut;
use rigidformer_planning::planner::pushing::{Observation, Predictor, Stroke};
use serde_json::{Value, json};

use rigidformer_cli::shared::interrupt;

/// Longer than any request takes.
const PATIENCE: Duration = Duration::from_secs(120);
/// How often Ctrl-C is looked for meanwhile.
const GLANCE: Duration = Duration::from_millis(100);
/// Of what the process said on stderr, so many bytes are kept.
const LAST_WORDS: usize = 2000;
/// Of an answer that cannot be read, so many characters are shown.
const SHOWN: usize = 120;
const MODULE: &str = "rigidformer_lab.push_world";

/// Why the world cannot go on.
#[derive(Debug, thiserror::Error)]
pub(crate) enum WorldError {
    #[error("{} cannot be started ({source}); install the lab with tools/lab/setup.sh, or name its python with --python", python.display())]
    Start { python: PathBuf, source: std::io::Error },
    #[error("the world, {} -m {MODULE}, ended{}{}", python.display(), said(words), remedy(words))]
    Ended { python: PathBuf, words: String },
    #[error("the world said nothing for {} s to `{asked}`; try again, with fewer --futures for --planner engine", PATIENCE.as_secs())]
    Silent { asked: String },
    #[error(
        "the world answered `{asked}` with something else: {problem}: {shown}; --python must run this version's {MODULE}"
    )]
    Garbage { asked: String, problem: String, shown: String },
    #[error("the world refused `{asked}`: {why}")]
    Refused { asked: String, why: String },
    #[error("interrupted")]
    Interrupted,
}

/// What Python runs: the module, without the current folder, where Python looks first and which nobody named. Pythons before 3.11
/// do not know PYTHONSAFEPATH.
fn start() -> String {
    format!(
        "import sys; sys.path[:] = filter(None, sys.path); import runpy; \
         runpy.run_module('{MODULE}', run_name='__main__', alter_sys=True)"
    )
}

fn said(words: &str) -> String {
    match words.trim() {
        "" => ", without a word".into(),
        words => format!(": {words}"),
    }
}

fn remedy(words: &str) -> &'static str {
    match words.contains("No module named") {
        true => "; install the lab with tools/lab/setup.sh, and name its python with --python",
        false => "",
    }
}

/// A unit of the world.
pub(crate) struct Body {
    pub(crate) points: Vec<Point3<f32>>,
    pub(crate) physics: Physics,
}

/// A trial as it begins.
pub(crate) struct Scene {
    pub(crate) frame_s: f32,
    pub(crate) gravity_m_s2: Vector3<f32>,
    pub(crate) ground: Plane,
    pub(crate) cube: Body,
    pub(crate) pusher: Body,
    pub(crate) radius_m: f32,
    /// x, y, yaw.
    pub(crate) goal: [f32; 3],
    pub(crate) observation: Observation,
}

/// The process. It ends with this.
pub(crate) struct World {
    python: PathBuf,
    child: Child,
    stdin: Option<ChildStdin>,
    lines: Receiver<String>,
    words: Arc<Mutex<String>>,
}

impl World {
    pub(crate) fn start(python: &Path) -> Result<World, WorldError> {
        let failed = |source| WorldError::Start { python: python.into(), source };
        let mut child = Command::new(python)
            .args(["-c", &start()])
            .env("PYTHONSAFEPATH", "1")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(failed)?;
        let words = Arc::new(Mutex::new(String::new()));
        if let Some(mut stderr) = child.stderr.take() {
            let words = Arc::clone(&words);
            std::thread::spawn(move || {
                let mut buffer = [0; 1024];
                while let Ok(count @ 1..) = stderr.read(&mut buffer) {
                    let mut words = words.lock().unwrap_or_else(PoisonError::into_inner);
                    words.push_str(&String::from_utf8_lossy(&buffer[..count]));
                    let mut surplus = words.len().saturating_sub(LAST_WORDS);
                    while !words.is_char_boundary(surplus) {
                        surplus += 1;
                    }
                    words.drain(..surplus);
                }
            });
        }
        let (send, lines) = channel();
        if let Some(stdout) = child.stdout.take() {
            std::thread::spawn(move || {
                for line in BufReader::new(stdout).split(b'\n') {
                    let Ok(line) = line else { return };
                    if send.send(String::from_utf8_lossy(&line).into_owned()).is_err() {
                        return;
                    }
                }
            });
        }
        let stdin = child.stdin.take();
        Ok(World { python: python.into(), child, stdin, lines, words })
    }

    /// A new trial.
    pub(crate) fn reset(&mut self, seed: u64) -> Result<Scene, WorldError> {
        self.ask("reset", &json!({"do": "reset", "seed": seed}), |answer| {
            let body = |name: &str| {
                let value = field(answer, name)?;
                let [mass_kg, friction, restitution] = ["mass_kg", "friction", "restitution"]
                    .map(|name| field(value, name).and_then(|value| number(value, name)));
                let physics =
                    Physics { mass_kg: mass_kg?, friction: friction?, restitution: restitution? };
                let points = field(value, "points")?.as_array().ok_or("`points` is no list")?;
                let points = points.iter().map(|point| numbers(point, "points").map(Point3::from));
                Ok::<_, String>(Body { points: points.collect::<Result<_, _>>()?, physics })
            };
            let [friction, restitution] = numbers(field(answer, "ground")?, "ground")?;
            Ok(Scene {
                frame_s: number(field(answer, "frame_s")?, "frame_s")?,
                gravity_m_s2: Vector3::from(numbers(
                    field(answer, "gravity_m_s2")?,
                    "gravity_m_s2",
                )?),
                ground: Plane::ground(friction, restitution),
                cube: body("cube")?,
                pusher: body("pusher")?,
                radius_m: number(field(answer, "radius_m")?, "radius_m")?,
                goal: numbers(field(answer, "goal")?, "goal")?,
                observation: observation(answer)?,
            })
        })
    }

    /// Moves the pusher along a path, at least one place.
    pub(crate) fn act(&mut self, path_m: &[[f32; 2]]) -> Result<Observation, WorldError> {
        self.ask("act", &json!({"do": "act", "path": path_m}), observation)
    }

    /// (strokes, steps) The cube's poses.
    fn rollout(&mut self, strokes: &[Stroke]) -> Result<Vec<Vec<Isometry3<f32>>>, WorldError> {
        let paths =
            strokes.iter().map(|stroke| json!({"from": stroke.from_m, "path": stroke.places_m}));
        self.ask(
            "rollout",
            &json!({"do": "rollout", "paths": paths.collect::<Value>()}),
            |answer| {
                let all = field(answer, "poses")?.as_array().ok_or("`poses` is no list")?;
                if all.len() != strokes.len() {
                    return Err(format!("{} paths instead of {}", all.len(), strokes.len()));
                }
                let path = |path: &Value| {
                    let poses = path.as_array().ok_or("`poses` holds something that is no list")?;
                    poses.iter().map(pose).collect::<Result<_, String>>()
                };
                all.iter().map(path).collect()
            },
        )
    }

    fn ask<T>(
        &mut self,
        what: &str,
        request: &Value,
        read: impl FnOnce(&Value) -> Result<T, String>,
    ) -> Result<T, WorldError> {
        let written = match &mut self.stdin {
            Some(stdin) => writeln!(stdin, "{request}").and_then(|()| stdin.flush()),
            None => Err(std::io::ErrorKind::BrokenPipe.into()),
        };
        if written.is_err() {
            return Err(self.ended());
        }
        let asked = || what.to_owned();
        let began = Instant::now();
        let line = loop {
            match self.lines.recv_timeout(GLANCE) {
                Ok(line) => break line,
                Err(RecvTimeoutError::Disconnected) => return Err(self.ended()),
                Err(RecvTimeoutError::Timeout) => {}
            }
            interrupt::check().map_err(|_| WorldError::Interrupted)?;
            if began.elapsed() > PATIENCE {
                return Err(WorldError::Silent { asked: asked() });
            }
        };
        let garbage = |problem: String| {
            let shown = line.chars().take(SHOWN).collect();
            WorldError::Garbage { asked: asked(), problem, shown }
        };
        let answer: Value =
            serde_json::from_str(&line).map_err(|error| garbage(format!("no JSON ({error})")))?;
        if let Some(why) = answer.get("error") {
            let why = why.as_str().map_or_else(|| why.to_string(), str::to_owned);
            return Err(WorldError::Refused { asked: asked(), why });
        }
        read(&answer).map_err(garbage)
    }

    /// The process has closed a pipe.
    fn ended(&mut self) -> WorldError {
        // Ctrl-C ends it too.
        if interrupt::check().is_err() {
            return WorldError::Interrupted;
        }
        // What it said last arrives with its end.
        let began = Instant::now();
        while matches!(self.child.try_wait(), Ok(None)) && began.elapsed() < Duration::from_secs(2)
        {
            std::thread::sleep(Duration::from_millis(10));
        }
        std::thread::sleep(Duration::from_millis(50));
        let words = self.words.lock().unwrap_or_else(PoisonError::into_inner).clone();
        WorldError::Ended { python: self.python.clone(), words }
    }
}

impl Drop for World {
    fn drop(&mut self) {
        self.stdin = None;
        let began = Instant::now();
        while matches!(self.child.try_wait(), Ok(None)) {
            if began.elapsed() > Duration::from_secs(2) {
                // It may be gone by now.
                let _ = self.child.kill();
                let _ = self.child.wait();
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

/// Predicts with the world itself: the planner that knows everything.
impl Predictor for World {
    type Error = WorldError;

    fn predict(
        &mut self,
        _: &Observation,
        strokes: &[Stroke],
        _: &(dyn Fn() -> Option<Cut> + Sync),
        out: &mut Vec<Vec<Isometry3<f32>>>,
    ) -> Result<(), WorldError> {
        // A stroke without places is one that cannot be gone.
        let possible: Vec<Stroke> =
            strokes.iter().filter(|stroke| !stroke.places_m.is_empty()).cloned().collect();
        let mut found = self.rollout(&possible)?.into_iter();
        out.extend(strokes.iter().map(|stroke| match stroke.places_m.is_empty() {
            true => Vec::new(),
            false => found.next().unwrap_or_default(),
        }));
        Ok(())
    }
}

fn field<'v>(value: &'v Value, name: &str) -> Result<&'v Value, String> {
    value.get(name).ok_or_else(|| format!("no `{name}`"))
}

fn number(value: &Value, name: &str) -> Result<f32, String> {
    let number = value.as_f64().map(|number| number as f32);
    number.filter(|number| number.is_finite()).ok_or_else(|| format!("`{name}` is no number"))
}

fn numbers<const N: usize>(value: &Value, name: &str) -> Result<[f32; N], String> {
    let all = value.as_array().filter(|all| all.len() == N);
    let all = all.ok_or_else(|| format!("`{name}` is not {N} numbers"))?;
    let mut out = [0.0; N];
    for (out, value) in out.iter_mut().zip(all) {
        *out = number(value, name)?;
    }
    Ok(out)
}

fn pose(value: &Value) -> Result<Isometry3<f32>, String> {
    let [x, y, z, w, i, j, k] = numbers(value, "pose")?;
    let turn = UnitQuaternion::try_new(Quaternion::new(w, i, j, k), 1e-3);
    let turn = turn.ok_or("a pose's quaternion is 0")?;
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), turn))
}

fn observation(answer: &Value) -> Result<Observation, String> {
    let at = |time: &str, unit: &str| pose(field(field(answer, time)?, unit)?);
    Ok(Observation {
        body_before: at("previous", "cube")?,
        body: at("current", "cube")?,
        pusher_before: at("previous", "pusher")?,
        pusher: at("current", "pusher")?,
    })
}
