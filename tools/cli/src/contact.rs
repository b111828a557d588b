//! `--contact`: contact's numbers in place of those of scenes.

use rigidformer_evaluation::scenes::RecordedScene;

use crate::arguments::Contact;

/// Scenes with the numbers of the file, if there is one.
#[cfg(feature = "calibrate")]
pub(crate) fn applied(
    option: &Contact,
    scenes: Vec<RecordedScene>,
) -> anyhow::Result<Vec<RecordedScene>> {
    let Some(path) = &option.path else { return Ok(scenes) };
    let contact = rigidformer_evaluation::contact::Contact::open(path)?;
    scenes.iter().map(|scene| Ok(contact.applied(scene)?)).collect()
}

/// A program without such numbers takes none.
#[cfg(not(feature = "calibrate"))]
pub(crate) fn applied(
    option: &Contact,
    scenes: Vec<RecordedScene>,
) -> anyhow::Result<Vec<RecordedScene>> {
    match option.path {
        Some(_) => Err(crate::usage::missing("--contact", "calibrate").into()),
        None => Ok(scenes),
    }
}

/// As [`applied`], of one scene.
pub(crate) fn applied_to(option: &Contact, scene: RecordedScene) -> anyhow::Result<RecordedScene> {
    let scenes = applied(option, vec![scene])?;
    scenes.into_iter().next().ok_or_else(|| anyhow::anyhow!("no scene"))
}
