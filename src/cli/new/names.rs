//! Names of projects, and those that a project cannot have because it could not be built.

use super::Template;

const MAX_NAME_LENGTH: usize = 40;

/// Reserved names, separated by spaces and with `_` for `-`.
struct ReservedNames {
    /// Role of the names, after "it is".
    role: &'static str,
    names: &'static str,
}

const ALL_TEMPLATES: &[ReservedNames] = &[ReservedNames {
    role: "a device of Windows",
    names: "aux com0 com1 com2 com3 com4 com5 com6 com7 com8 com9 con lpt0 lpt1 lpt2 lpt3 lpt4 lpt5 lpt6 lpt7 lpt8 \
            lpt9 nul prn",
}];

const RUST: &[ReservedNames] = &[
    ReservedNames {
        role: "a keyword of Rust",
        names: "abstract as async await become box break const continue crate do dyn else enum extern false final fn \
                for gen if impl in let loop macro match mod move mut override priv pub ref return self static struct \
                super trait true try type typeof union unsafe unsized use virtual where while yield",
    },
    ReservedNames {
        role: "a type of Rust",
        names: "bool char f128 f16 f32 f64 i128 i16 i32 i64 i8 isize str u128 u16 u32 u64 u8 usize",
    },
    ReservedNames {
        role: "a crate of Rust's standard library",
        names: "alloc core proc_macro std test",
    },
    ReservedNames {
        role: "a folder that Cargo needs beside the program",
        names: "build deps examples incremental",
    },
    ReservedNames {
        role: "a crate of the fuzz target",
        names: "libfuzzer_sys",
    },
];

const PYTHON: &[ReservedNames] = &[
    ReservedNames {
        role: "a keyword of Python",
        names: "and as assert async await break class continue def del elif else except finally for from global if \
                import in is lambda nonlocal not or pass raise return try while with yield",
    },
    ReservedNames {
        role: "a module of Python's standard library",
        names: "abc aifc annotationlib antigravity argparse array ast asynchat asyncio asyncore atexit audioop base64 \
                bdb binascii binhex bisect builtins bz2 calendar cgi cgitb chunk cmath cmd code codecs codeop \
                collections colorsys compileall compression concurrent configparser contextlib contextvars copy \
                copyreg crypt csv ctypes curses dataclasses datetime dbm decimal difflib dis distutils doctest email \
                encodings ensurepip enum errno faulthandler fcntl filecmp fileinput fnmatch fractions ftplib functools \
                gc genericpath getopt getpass gettext glob graphlib grp gzip hashlib heapq hmac html http idlelib \
                imaplib imghdr imp importlib inspect io ipaddress itertools json keyword lib2to3 linecache locale \
                logging lzma mailbox mailcap marshal math mimetypes mmap modulefinder msilib msvcrt multiprocessing \
                netrc nis nntplib nt ntpath nturl2path numbers opcode operator optparse os ossaudiodev pathlib pdb \
                pickle pickletools pipes pkgutil platform plistlib poplib posix posixpath pprint profile pstats pty \
                pwd py_compile pyclbr pydoc pydoc_data pyexpat queue quopri random re readline reprlib resource \
                rlcompleter runpy sched secrets select selectors shelve shlex shutil signal site smtpd smtplib sndhdr \
                socket socketserver spwd sqlite3 sre_compile sre_constants sre_parse ssl stat statistics string \
                stringprep struct subprocess sunau symtable sys sysconfig syslog tabnanny tarfile telnetlib tempfile \
                termios test textwrap this threading time timeit tkinter token tokenize tomllib trace traceback \
                tracemalloc tty turtle turtledemo types typing unicodedata unittest urllib uu uuid venv warnings wave \
                weakref webbrowser winreg winsound wsgiref xdrlib xml xmlrpc zipapp zipfile zipimport zlib zoneinfo",
    },
    ReservedNames {
        // Python finds the project's module before the installed one, so that the importing program fails.
        role: "a module that pip, pytest, its plugins or crumple import",
        names: "annotated_types anyio argcomplete attr attrs black click cloudpickle colorama conftest coverage \
                cython dateutil django eventlet exceptiongroup execnet farama_notifications gevent greenlet \
                gymnasium hypothesis importlib_metadata iniconfig jax libcst matplotlib maturin mock mypy numpy \
                optuna packaging pandas pexpect pip pkg_resources platformdirs pluggy polars psutil py pyarrow \
                pydantic pygments pytest regex rich rtamt scipy setproctitle setup setuptools sitecustomize six \
                sniffio sortedcontainers stable_baselines3 tomli torch twisted typing_extensions usercustomize \
                watchdog wheel xdist yaml zope",
    },
];

const C: &[ReservedNames] = &[
    ReservedNames {
        role: "a file that `make` reads",
        names: "makefile",
    },
    ReservedNames {
        role: "a target of the makefile",
        names: "test",
    },
];

/// Checks the name of a project. The error is the reason, as the end of a message.
pub(super) fn check_name(name: &str, template: Template) -> Result<(), String> {
    let is_plain = (1..=MAX_NAME_LENGTH).contains(&name.len())
        && name.starts_with(|letter: char| letter.is_ascii_lowercase())
        && !name.ends_with('-')
        && name
            .bytes()
            .all(|byte| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'-'));
    if !is_plain {
        return Err(format!(
            "use 1 to {MAX_NAME_LENGTH} of a-z, 0-9 and -, and begin with a letter, and do not end with -"
        ));
    }
    if name == "crumple" || name.starts_with("crumple-") {
        return Err("names that begin with crumple are those of its own packages".to_owned());
    }
    if name.starts_with("pytest-") && matches!(template, Template::Python) {
        return Err("names that begin with pytest- are those of its plugins".to_owned());
    }
    let of_template = match template {
        Template::Rust => RUST,
        Template::Python => PYTHON,
        Template::C => C,
    };
    let module = name.replace('-', "_");
    let mut reserved = ALL_TEMPLATES.iter().chain(of_template);
    match reserved.find(|reserved| reserved.names.split_whitespace().any(|name| name == module)) {
        Some(ReservedNames { role, .. }) => Err(format!("it is {role}")),
        None => Ok(()),
    }
}
