//! The two models that are compared.

use rigidformer_runtime::models::LoadedModel;

pub(crate) struct Pair<'m> {
    pub(crate) float: &'m LoadedModel,
    pub(crate) quantised: &'m LoadedModel,
}
