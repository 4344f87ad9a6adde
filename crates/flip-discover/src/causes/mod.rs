//! What may explain a departure, and what each cause would show in the runs of a campaign.

pub(crate) mod catalogue;
pub(crate) mod follows;
pub(crate) mod hook;
pub(crate) mod hypothesis;
pub(crate) mod response;
pub(crate) mod signature;
