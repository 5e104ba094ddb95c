//! Job files: a shell script that runs one shard, and for each engine a file that runs all shards.
//!
//! User-supplied text stands only in the script, quoted for a POSIX shell. Engine files contain numbers and its name.

use crumple_core::quoting::ShellWord;

use crate::shard::MAX_SHARDS;

/// A run to be divided into shards.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Jobs {
    /// Words after `crumple --quiet` of the undivided run, without `--shard`, `--out` and `--resume`.
    pub arguments: Vec<String>,
    /// Number of shards.
    pub shards: u32,
    /// Cores for each shard.
    pub cores: u32,
    /// Slurm's time limit of a shard, in minutes.
    pub max_minutes: u64,
    /// Folder of the job files and shards, as the user would write it in the folder of submission.
    pub folder: String,
}

/// An engine that distributes the shards.
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
    /// All engines.
    pub const ALL: [Self; 3] = [Self::HyperQueue, Self::Ray, Self::Slurm];
}

/// Runs `work` in a one-thread rayon pool.
pub fn run_on_one_core<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    match rayon::ThreadPoolBuilder::new().num_threads(1).build() {
        Ok(one) => one.install(work),
        // Without a pool, fall back to all cores.
        Err(_) => work(),
    }
}

/// Name of the script that runs a shard.
pub const TASK_SCRIPT: &str = "task.sh";

impl Jobs {
    /// Returns the script that runs a shard. Its argument, HyperQueue or Slurm provides the index of the shard.
    #[must_use]
    pub fn task_script(&self) -> String {
        let words: Vec<String> = self.arguments.iter().map(|word| ShellWord(word).to_string()).collect();
        let shards = ShellWord(&format!("{}/shards/", self.folder)).to_string();
        format!(
            "#!/bin/sh\n\
             # Makes shard N of {of}: task.sh N. Start it where `crumple plan` was started. Finished work is kept.\n\
             set -eu\n\
             shard=${{1:-${{HQ_TASK_ID:-${{SLURM_ARRAY_TASK_ID:?give the number of a shard, 1 to {of}}}}}}}\n\
             RAYON_NUM_THREADS={cores}\n\
             export RAYON_NUM_THREADS\n\
             exec \"${{CRUMPLE:-crumple}}\" --quiet {words} \\\n  --shard \"$shard/{of}\" --out={shards}\"$shard\" \
             --resume\n",
            of = self.shards,
            cores = self.cores,
            words = words.join(" "),
        )
    }

    /// Returns the name and the text of an engine's file.
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
                    "#!/bin/sh\n#SBATCH --job-name=crumple\n#SBATCH --array=1-{shards}\n#SBATCH \
                     --cpus-per-task={cores}\n\
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

    /// Runs the script with a program in place of crumple that prints its arguments, and returns them.
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

        /// A shell reads any name of a controller or folder as one word, and runs nothing else.
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

    /// The engine files contain only numbers, and no placeholder is left.
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
