//! The two models that are compared.

use rigidformer_runtime::core::Model;

pub(crate) struct Pair<'m> {
    pub(crate) float: Model<'m>,
    pub(crate) quantised: Model<'m>,
}
