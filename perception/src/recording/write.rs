//! Writes depth recordings.

use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};
use std::{fs, io};

use nalgebra::Vector3;
use rigidformer_runtime::files::write_whole;

use super::error::{CaptureError, CaptureProblem};
use super::image;
use super::manifest::{CameraEntry, DepthManifest, FrameEntry, NAME, Times, numbers};
use crate::camera::Camera;
use crate::capture::DepthView;

/// Temporary folders of killed processes that are skipped, at most.
const MAX_LEFTOVER_FOLDERS: u32 = 100;

/// A depth recording that is being written.
///
/// Images go to a temporary folder beside the one that is asked for; [`finish`](Self::finish) gives that its name. A recorder that
/// is dropped before leaves nothing behind.
///
/// ```
/// use nalgebra::Isometry3;
/// use rigidformer_perception::camera::Camera;
/// use rigidformer_perception::capture::DepthView;
/// use rigidformer_perception::recording::{self, Recorder};
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("seen");
/// let camera = Camera::new([4, 3], [4.0, 4.0], [1.5, 1.0], Isometry3::identity())?;
/// let mut recorder = Recorder::new(&path, None)?;
/// let left = recorder.camera("left", &camera, 0.001)?;
/// for frame in 0..2 {
///     let view = DepthView::new(camera, 0.001, vec![1000 + frame; 12], None)?;
///     recorder.add(f64::from(frame) / 30.0, left, &view)?;
/// }
/// recorder.finish()?;
///
/// let captures = recording::open(&path)?;
/// assert_eq!(captures.count_left(), Some(2));
/// let times: Result<Vec<_>, _> = captures.map(|capture| capture.map(|capture| capture.time_s)).collect();
/// assert_eq!(times?, [0.0, 1.0 / 30.0]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Recorder {
    /// Where the recording will be.
    path: PathBuf,
    /// Where it is until then; none once it is finished.
    temporary: Option<PathBuf>,
    gravity_m_s2: Option<Vector3<f32>>,
    cameras: Vec<(CameraEntry, Camera)>,
    frames: Vec<FrameEntry>,
    times: Times,
    /// Cameras that the capture has.
    of_capture: Vec<usize>,
}

impl Recorder {
    /// A recording in a folder that does not exist yet, or is empty, in one that does; with the gravity of its world, if it is known.
    ///
    /// # Errors
    /// [`CaptureProblem::Exists`] and [`CaptureProblem::Unwritable`].
    pub fn new(path: &Path, gravity_m_s2: Option<Vector3<f32>>) -> Result<Self, CaptureError> {
        let fail = |problem| CaptureError::of(path, problem);
        // An empty folder is replaced.
        let is_empty = || fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_none());
        if path.symlink_metadata().is_ok() && !is_empty() {
            return Err(fail(CaptureProblem::Exists));
        }
        let Some(name) = path.file_name() else { return Err(fail(CaptureProblem::Exists)) };
        let temporary = temporary_folder(path, name)
            .map_err(|error| fail(CaptureProblem::Unwritable(error)))?;
        Ok(Recorder {
            path: path.into(),
            temporary: Some(temporary),
            gravity_m_s2,
            cameras: Vec::new(),
            frames: Vec::new(),
            times: Times::default(),
            of_capture: Vec::new(),
        })
    }

    /// Adds a camera and gives its number; its images have steps of `scale_m` metres.
    ///
    /// # Errors
    /// [`CaptureProblem::DuplicateCamera`], and [`CaptureProblem::Outside`] for a name with which no file can begin.
    pub fn camera(
        &mut self,
        name: &str,
        camera: &Camera,
        scale_m: f32,
    ) -> Result<usize, CaptureError> {
        let fail = |problem| CaptureError::at(&self.path, &format!("camera {name:?}"), problem);
        if self.cameras.iter().any(|(known, _)| known.name == name) {
            return Err(fail(CaptureProblem::DuplicateCamera));
        }
        let is_plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_');
        if name.is_empty() || name.len() > 64 || !name.chars().all(is_plain) {
            return Err(fail(CaptureProblem::Outside(name.into())));
        }
        let ([width, height], [fx, fy], [cx, cy]) =
            (camera.size(), camera.focal(), camera.centre());
        let entry = CameraEntry {
            name: name.into(),
            width,
            height,
            fx,
            fy,
            cx,
            cy,
            depth_scale_m: scale_m,
            pose: numbers(camera.pose()),
        };
        self.cameras.push((entry, *camera));
        Ok(self.cameras.len() - 1)
    }

    /// Writes an image of a camera. Times do not go back, and frames within a millisecond are one capture. A refused call changes nothing.
    ///
    /// # Errors
    /// [`CaptureProblem::UnknownCamera`], [`CaptureProblem::Backwards`], [`CaptureProblem::Duplicate`],
    /// [`CaptureProblem::ImageSize`] for a view of other intrinsics or another scale than its camera's, and
    /// [`CaptureProblem::Unwritable`].
    pub fn add(
        &mut self,
        time_s: f64,
        camera: usize,
        view: &DepthView,
    ) -> Result<(), CaptureError> {
        let number = self.frames.len();
        let fail = |problem| CaptureError::at(&self.path, &format!("frame {number}"), problem);
        let Some((entry, known)) = self.cameras.get(camera) else {
            return Err(fail(CaptureProblem::UnknownCamera(camera.to_string())));
        };
        let size = known.size();
        let is_same = view.camera.moved(*known.pose()).is_ok_and(|moved| moved == *known)
            && view.scale_m == entry.depth_scale_m;
        if !is_same {
            let found = view.camera.size();
            return Err(fail(CaptureProblem::ImageSize { found, camera: size }));
        }
        let mut times = self.times;
        let is_new = times.is_new(time_s).map_err(fail)?;
        if !is_new && self.of_capture.contains(&camera) {
            return Err(fail(CaptureProblem::Duplicate(time_s)));
        }
        let Some(folder) = &self.temporary else { return Ok(()) };
        let write = |name: &str, pixels: &[u16]| -> Result<(), CaptureError> {
            let bytes = image::encode(pixels, size).map_err(fail)?;
            Ok(write_whole(&folder.join(name), &bytes)?)
        };
        let stem = format!("{number:05}-{}", entry.name);
        let (depth, labels) = (format!("{stem}.png"), format!("{stem}-labels.png"));
        write(&depth, &view.depth)?;
        if let Some(pixels) = &view.labels {
            write(&labels, pixels)?;
        }
        let pose = (view.camera.pose() != known.pose()).then(|| numbers(view.camera.pose()));
        self.frames.push(FrameEntry {
            time_s,
            camera: entry.name.clone(),
            depth,
            labels: view.labels.as_ref().map(|_| labels),
            pose,
        });
        self.times = times;
        if is_new {
            self.of_capture.clear();
        }
        self.of_capture.push(camera);
        Ok(())
    }

    /// Writes another file into the folder, such as a picture for people.
    ///
    /// # Errors
    /// [`CaptureProblem::Unwritable`], and [`CaptureProblem::Outside`] for a name that is not a plain one.
    pub fn extra(&mut self, name: &str, bytes: &[u8]) -> Result<(), CaptureError> {
        if Path::new(name).file_name().is_none_or(|plain| plain != name) || name == NAME {
            return Err(CaptureError::of(&self.path, CaptureProblem::Outside(name.into())));
        }
        match &self.temporary {
            Some(folder) => Ok(write_whole(&folder.join(name), bytes)?),
            None => Ok(()),
        }
    }

    /// Writes `frames.json` and gives the folder its name.
    ///
    /// # Errors
    /// [`CaptureProblem::Empty`] without frames, and [`CaptureProblem::Unwritable`]; then nothing is left.
    pub fn finish(mut self) -> Result<(), CaptureError> {
        let fail = |problem| CaptureError::of(&self.path, problem);
        if self.frames.is_empty() {
            return Err(fail(CaptureProblem::Empty));
        }
        let cameras = self.cameras.iter().map(|(entry, _)| entry.clone()).collect();
        let gravity = self.gravity_m_s2.map(|gravity| [gravity.x, gravity.y, gravity.z]);
        let manifest = DepthManifest::new(gravity, cameras, std::mem::take(&mut self.frames));
        let json = serde_json::to_vec_pretty(&manifest);
        let json = json.map_err(|error| fail(CaptureProblem::Json(error.to_string())))?;
        let Some(folder) = &self.temporary else { return Ok(()) };
        write_whole(&folder.join(NAME), &json)?;
        // Some systems do not rename over an empty folder.
        if self.path.is_dir() {
            fs::remove_dir(&self.path).map_err(|error| fail(CaptureProblem::Unwritable(error)))?;
        }
        fs::rename(folder, &self.path).map_err(|error| fail(CaptureProblem::Unwritable(error)))?;
        sync_parent(&self.path);
        self.temporary = None;
        Ok(())
    }
}

/// The new name outlasts a loss of power, where the system lets a folder be synced.
fn sync_parent(path: &Path) {
    if cfg!(unix) {
        let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty());
        let folder = fs::File::open(parent.unwrap_or(Path::new(".")));
        // The recording is there already: a file system that cannot sync folders does not make it fail.
        let _ = folder.and_then(|folder| folder.sync_all());
    }
}

/// Makes a hidden folder beside the one that is asked for.
fn temporary_folder(path: &Path, name: &OsStr) -> io::Result<PathBuf> {
    let mut number = 0;
    loop {
        let mut hidden = OsString::from(".");
        hidden.push(name);
        hidden.push(format!(".{}-{number}.part", std::process::id()));
        let folder = path.with_file_name(hidden);
        match fs::create_dir(&folder) {
            Ok(()) => return Ok(folder),
            // A killed process with the same id left its folder.
            Err(error)
                if error.kind() == io::ErrorKind::AlreadyExists
                    && number < MAX_LEFTOVER_FOLDERS =>
            {
                number += 1;
            }
            Err(error) => return Err(error),
        }
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        if let Some(folder) = &self.temporary {
            // `drop` cannot report an error.
            let _ = fs::remove_dir_all(folder);
        }
    }
}
