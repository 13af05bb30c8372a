//! Writing a file whole or not at all.

use std::path::Path;

/// Writes `bytes` beside `path` and renames, so that `path` is never half a file.
///
/// # Errors
/// Whatever the file system says, and that `path` is there but no file: a rename would replace a
/// device or a pipe.
pub fn write_whole(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    if path.exists() && !path.is_file() {
        return Err(std::io::Error::other("it is not a regular file"));
    }
    let mut name = path.file_name().ok_or(std::io::ErrorKind::IsADirectory)?.to_owned();
    name.push(format!(".{}.part", std::process::id()));
    let part = path.with_file_name(name);
    std::fs::write(&part, bytes).and_then(|()| std::fs::rename(&part, path)).inspect_err(|_| {
        // Best effort: the error that matters is the one that is returned.
        let _ = std::fs::remove_file(&part);
    })
}
