//! Which display the window opens on, where one that is named does not answer.

#[cfg(target_os = "linux")]
pub(super) use linux::force_x11;

#[cfg(target_os = "linux")]
mod linux {
    use std::ffi::OsString;
    use std::io::{Read as _, Write as _};
    use std::os::unix::net::UnixStream;
    use std::path::PathBuf;
    use std::time::Duration;

    use crate::ui::WindowError;

    /// How long a display is waited for; a living one answers in a few milliseconds.
    const PATIENCE: Duration = Duration::from_secs(2);

    /// Whether X is to be used although a Wayland display is named, for that one does not answer.
    ///
    /// `Err` where there is no other: a library would wait for ever.
    pub(crate) fn force_x11() -> Result<bool, WindowError> {
        let named = |name| std::env::var_os(name).filter(|value| !value.is_empty());
        // What was handed down as an open connection cannot be tried without using it up.
        if named("WAYLAND_SOCKET").is_some() {
            return Ok(false);
        }
        let Some(display) = named("WAYLAND_DISPLAY") else { return Ok(false) };
        let answers = socket(display, named("XDG_RUNTIME_DIR")).is_some_and(|path| {
            UnixStream::connect(path).is_ok_and(|mut stream| is_answered(&mut stream, PATIENCE))
        });
        match (answers, named("DISPLAY")) {
            (true, _) => Ok(false),
            (false, Some(x11)) => {
                log::warn!("the Wayland display does not answer: the window opens on the X display {x11:?}");
                Ok(true)
            }
            (false, None) => Err(WindowError::Wayland),
        }
    }

    /// Where a display of this name listens.
    fn socket(display: OsString, runtime_dir: Option<OsString>) -> Option<PathBuf> {
        let display = PathBuf::from(display);
        if display.is_absolute() {
            return Some(display);
        }
        runtime_dir.map(|dir| PathBuf::from(dir).join(display)).filter(|path| path.is_absolute())
    }

    /// Whether a display is at the other end: asked to call back, it does.
    fn is_answered(stream: &mut UnixStream, patience: Duration) -> bool {
        // `wl_display.sync`: object 1, the length of the message and method 0, and the name of what is to be called back.
        let sync: Vec<u8> = [1_u32, 12 << 16, 2].into_iter().flat_map(u32::to_ne_bytes).collect();
        let mut header = [0; 8];
        stream.set_read_timeout(Some(patience)).is_ok()
            && stream.set_write_timeout(Some(patience)).is_ok()
            && stream.write_all(&sync).is_ok()
            && stream.read_exact(&mut header).is_ok()
    }

    #[cfg(test)]
    mod tests {
        use std::os::unix::net::UnixListener;

        use super::*;

        #[test]
        fn a_display_is_found_as_wayland_finds_it() {
            let of = |display: &str, dir: Option<&str>| socket(display.into(), dir.map(Into::into));
            assert_eq!(of("wayland-0", Some("/run/user/7")), Some("/run/user/7/wayland-0".into()));
            assert_eq!(of("/tmp/mine", None), Some("/tmp/mine".into()));
            assert_eq!((of("wayland-0", None), of("wayland-0", Some("run"))), (None, None));
        }

        #[test]
        fn a_socket_that_nobody_listens_on_or_answers_at_is_no_display() {
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("wayland-nobody");
            assert!(UnixStream::connect(&path).is_err(), "there is none");
            let listener = UnixListener::bind(&path).unwrap();
            let mut stream = UnixStream::connect(&path).unwrap();
            assert!(!is_answered(&mut stream, Duration::from_millis(20)), "who listens has hung");
            drop(listener);
            assert!(UnixStream::connect(&path).is_err(), "its file is left behind");
        }

        #[test]
        fn a_display_that_calls_back_answers() {
            let (mut ours, mut theirs) = UnixStream::pair().unwrap();
            let done: Vec<u8> = [2_u32, 12 << 16, 0].into_iter().flat_map(u32::to_ne_bytes).collect();
            theirs.write_all(&done).unwrap();
            assert!(is_answered(&mut ours, Duration::from_secs(2)));
            let mut asked = [0; 12];
            theirs.read_exact(&mut asked).unwrap();
            assert_eq!(asked[..4], 1_u32.to_ne_bytes(), "the display itself was asked");
        }
    }
}

#[cfg(not(target_os = "linux"))]
use crate::ui::WindowError;

/// Elsewhere there is one display.
#[cfg(not(target_os = "linux"))]
pub(super) fn force_x11() -> Result<bool, WindowError> {
    Ok(false)
}
