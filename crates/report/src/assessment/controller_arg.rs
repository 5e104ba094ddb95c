//! Arguments that name controllers in the commands of a report, and their files in its folder.

use crumple_controllers::controller_file;
use crumple_networks::NetworkController;
use crumple_process::ProcessController;
use crumple_sim::control::{BuiltInController, ControllerSource, PolicySource};
use crumple_sim::policy::Policy;

/// Returns the controller's command-line argument in the report folder; `None` for an external controller, and for a
/// process that copies of its files do not determine.
pub(super) fn controller_arg(source: &dyn ControllerSource) -> Option<String> {
    if let Some(shield) = source.as_shield() {
        let inner = controller_arg(&*shield.controller)?;
        return Some(format!("{}{inner}", shield.settings.name_prefix()));
    }
    if let Some(spec) = source.downcast_ref::<BuiltInController>() {
        return Some(spec.to_arg());
    }
    if let Some(network) = source.downcast_ref::<NetworkController>() {
        return Some(network_path(&controller_file::file_name(network)));
    }
    if let Some(process) = source.downcast_ref::<ProcessController>() {
        let folder = process_folder(process)?;
        let file = process.portable_file()?;
        return Some(format!("{folder}/{file}"));
    }
    let policy = source.downcast_ref::<PolicySource>()?;
    Some(policy_path(&policy.shared()))
}

pub(super) fn process_folder(process: &ProcessController) -> Option<String> {
    Some(format!("controllers/{}", process.identity()?.get(..16)?))
}

pub(super) fn network_path(name: &str) -> String {
    format!("controllers/{name}")
}

pub(super) fn policy_path(policy: &Policy) -> String {
    let digest = policy.digest();
    format!(
        "controllers/{}.safetensors",
        digest.get(..16).unwrap_or(&digest)
    )
}
