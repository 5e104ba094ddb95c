//! Files for engines that place work on machines: one script that makes a shard, and for each engine one that has all of them made.
//!
//! Whatever a user wrote stands in the script for a shard alone, each word quoted for a POSIX shell; what the engines read holds numbers
//! and, quoted likewise, the name of that script.

use crumple_core::quoting::ShellWord;

use crate::shard::MAX_SHARDS;

/// Work to be divided.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Jobs {
    /// The words after `crumple --quiet` that make the work as a whole, without `--shard`, `--out` and `--resume`.
    pub arguments: Vec<String>,
    /// Into how many shards.
    pub shards: u32,
    /// Cores for each.
    pub cores: u32,
    /// Minutes after which Slurm ends one.
    pub max_minutes: u64,
    /// Where the files go and the shards come to lie, as a user would write it where the jobs are begun.
    pub folder: String,
}

/// What places the work.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Engine {
    /// <https://it4innovations.github.io/hyperqueue>
    HyperQueue,
    /// <https://docs.ray.io>
    Ray,
    /// <https://slurm.schedmd.com>
    Slurm,
}

impl Engine {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::HyperQueue, Self::Ray, Self::Slurm];
}

/// Does something on one core, as a shard would.
pub fn run_on_one_core<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    match rayon::ThreadPoolBuilder::new().num_threads(1).build() {
        Ok(one) => one.install(work),
        // Without a pool of its own it is done on all cores.
        Err(_) => work(),
    }
}

/// The script that makes a shard.
pub const TASK_SCRIPT: &str = "task.sh";

impl Jobs {
    /// The script that makes a shard: which, is its argument, or what HyperQueue or Slurm say.
    #[must_use]
    pub fn task_script(&self) -> String {
        let words: Vec<String> = self.arguments.iter().map(|word| ShellWord(word).to_string()).collect();
        let shards = ShellWord(&format!("{}/shards/", self.folder)).to_string();
        format!(
            "#!/bin/sh\n\
             # Makes a shard of {of}: task.sh N. Begin it where `crumple plan` was begun. What is done is not done again.\n\
             set -eu\n\
             shard=${{1:-${{HQ_TASK_ID:-${{SLURM_ARRAY_TASK_ID:?which shard of {of}?}}}}}}\n\
             RAYON_NUM_THREADS={cores}\n\
             export RAYON_NUM_THREADS\n\
             exec \"${{CRUMPLE:-crumple}}\" --quiet {words} \\\n  --shard \"$shard/{of}\" --out={shards}\"$shard\" --resume\n",
            of = self.shards,
            cores = self.cores,
            words = words.join(" "),
        )
    }

    /// The name and the text of the file for an engine.
    #[must_use]
    pub fn engine_file(&self, engine: Engine) -> (&'static str, String) {
        let filled = |text: &str| {
            let (shards, cores) = (self.shards.min(MAX_SHARDS).to_string(), self.cores.to_string());
            text.replace("@SHARDS@", &shards).replace("@CORES@", &cores)
        };
        match engine {
            Engine::HyperQueue => ("hyperqueue_job.py", filled(include_str!("hyperqueue_job.py"))),
            Engine::Ray => ("ray_job.py", filled(include_str!("ray_job.py"))),
            Engine::Slurm => {
                let Self { shards, cores, max_minutes: most_minutes, folder, .. } = self;
                let task = format!("{folder}/{TASK_SCRIPT}");
                let text = format!(
                    "#!/bin/sh\n#SBATCH --job-name=crumple\n#SBATCH --array=1-{shards}\n#SBATCH --cpus-per-task={cores}\n\
                     #SBATCH --time={most_minutes}\n#SBATCH --requeue\n\
                     # sbatch runs a copy of this file, in the folder in which it was called.\n\
                     exec sh -- {}\n",
                    ShellWord(&task)
                );
                ("slurm.sh", text)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn jobs(controller: &str, folder: &str) -> Jobs {
        let words = ["verify", "rate", "--controller", controller].map(str::to_owned).to_vec();
        Jobs { arguments: words, shards: 8, cores: 2, max_minutes: 30, folder: folder.to_owned() }
    }

    /// What a shell makes of the script, with a program in place of crumple that prints its arguments.
    #[cfg(unix)]
    fn arguments(script: &str, name: &str, file: &str) -> Vec<String> {
        use std::os::unix::fs::PermissionsExt;

        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("print");
        std::fs::write(&program, "#!/bin/sh\nprintf '%s\\0' \"$@\"\n").unwrap();
        std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
        let place = folder.path().join(name);
        std::fs::write(&place, script).unwrap();
        let mut command = std::process::Command::new("sh");
        let command = command.arg(place).current_dir(folder.path()).env("CRUMPLE", program).env(file, "3");
        let output = command.output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let text = String::from_utf8(output.stdout).unwrap();
        text.split_terminator('\0').map(str::to_owned).collect()
    }

    #[cfg(unix)]
    proptest! {
        #![proptest_config(crumple_cases::with_cases(40))]

        /// Whatever somebody calls a controller or a folder, a shell reads it as that word, and nothing else is run.
        #[test]
        fn words_arrive_as_they_were_written(
            controller in "[a-z $`\"'\\\\;&|<>(){}*?!#~\n\u{202e}é=-]{1,20}",
            folder in "[a-z $`\"'\\\\;&|<>(){}*?!#~\n=-]{1,20}",
        ) {
            let found = arguments(&jobs(&controller, &folder).task_script(), TASK_SCRIPT, "HQ_TASK_ID");
            let out = format!("--out={folder}/shards/3");
            let expected =
                ["--quiet", "verify", "rate", "--controller", &controller, "--shard", "3/8", &out, "--resume"];
            prop_assert_eq!(found, expected);
        }
    }

    /// Their lines for the engine hold numbers alone, and nothing is left to be filled in.
    #[test]
    fn files_for_engines_are_filled_in() {
        for engine in Engine::ALL {
            let (name, text) = jobs("idm", "plan; rm -rf x").engine_file(engine);
            assert!(!text.contains('@') || engine == Engine::Ray, "{name}: {text}");
            assert!(!text.contains("@SHARDS@") && !text.contains("@CORES@") && !text.contains("idm"), "{name}");
            assert!(engine == Engine::Slurm || text.contains("SHARDS = 8\nCORES = 2\n"), "{name}");
        }
        let slurm = jobs("idm", "plan; rm -rf x").engine_file(Engine::Slurm).1;
        assert!(slurm.contains("--array=1-8\n") && slurm.ends_with("exec sh -- 'plan; rm -rf x/task.sh'\n"), "{slurm}");
    }
}
