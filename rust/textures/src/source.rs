//! Where the bytes of an image are: a file, a part of one, or memory.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::Error;

/// What images are read from.
pub(crate) trait Input: BufRead + Seek + Send {}

impl<T: BufRead + Seek + Send> Input for T {}

/// Bytes that are read when they are needed.
#[derive(Clone, Debug)]
pub(crate) struct Bytes {
    /// The file's name in messages.
    path: PathBuf,
    place: Place,
    start: u64,
    length: u64,
}

#[derive(Clone, Debug)]
enum Place {
    Disk,
    Memory(Arc<[u8]>),
}

impl Bytes {
    /// A regular file.
    pub(crate) fn of_file(path: &Path) -> Result<Self, Error> {
        let metadata = std::fs::metadata(path).map_err(Error::read(path))?;
        if !metadata.is_file() {
            // A pipe would be waited for without end.
            let source = std::io::Error::other("it is no regular file");
            return Err(Error::Read { path: path.to_owned(), source });
        }
        Ok(Bytes { path: path.to_owned(), place: Place::Disk, start: 0, length: metadata.len() })
    }

    pub(crate) fn held(path: &Path, bytes: Arc<[u8]>) -> Self {
        let length = bytes.len() as u64;
        Bytes { path: path.to_owned(), place: Place::Memory(bytes), start: 0, length }
    }

    /// `length` bytes from `start`; `None` if there are not so many.
    pub(crate) fn part(&self, start: u64, length: u64) -> Option<Self> {
        let end = start.checked_add(length)?;
        (end <= self.length).then(|| Bytes { start: self.start + start, length, ..self.clone() })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    pub(crate) fn length(&self) -> u64 {
        self.length
    }

    /// The first bytes, at most `most`.
    pub(crate) fn head(&self, most: u64) -> Result<Vec<u8>, Error> {
        let mut head = Vec::new();
        self.open()?.take(most).read_to_end(&mut head).map_err(Error::read(&self.path))?;
        Ok(head)
    }

    pub(crate) fn all(&self) -> Result<Vec<u8>, Error> {
        self.head(self.length)
    }

    pub(crate) fn open(&self) -> Result<Box<dyn Input>, Error> {
        match &self.place {
            Place::Memory(bytes) => {
                // `part` checks the range.
                let part = bytes.get(self.start as usize..(self.start + self.length) as usize);
                Ok(Box::new(Cursor::new(Arc::<[u8]>::from(part.unwrap_or_default()))))
            }
            Place::Disk if self.start == 0 => {
                let file = File::open(&self.path).map_err(Error::read(&self.path))?;
                Ok(Box::new(BufReader::new(file)))
            }
            Place::Disk => {
                let mut file = File::open(&self.path).map_err(Error::read(&self.path))?;
                file.seek(SeekFrom::Start(self.start)).map_err(Error::read(&self.path))?;
                let mut part = Vec::new();
                file.take(self.length).read_to_end(&mut part).map_err(Error::read(&self.path))?;
                Ok(Box::new(Cursor::new(part)))
            }
        }
    }
}

/// The files of a folder, on the disk or in memory.
#[derive(Debug)]
pub(crate) struct Files {
    folder: PathBuf,
    held: Option<BTreeMap<String, Arc<[u8]>>>,
}

impl Files {
    pub(crate) fn on_disk(folder: &Path) -> Self {
        Files { folder: folder.to_owned(), held: None }
    }

    pub(crate) fn in_memory(folder: &Path, files: impl IntoIterator<Item = (String, Vec<u8>)>) -> Self {
        let held = files.into_iter().map(|(name, bytes)| (name, bytes.into())).collect();
        Files { folder: folder.to_owned(), held: Some(held) }
    }

    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Names of the regular files in alphabetical order, but for hidden ones, such as the forks that macOS packs.
    pub(crate) fn names(&self) -> Result<Vec<String>, Error> {
        let mut names = match &self.held {
            Some(held) => held.keys().cloned().collect(),
            None => entries(&self.folder, Path::is_file)?,
        };
        names.retain(|name| !name.starts_with('.') && !name.contains('/'));
        names.sort();
        Ok(names)
    }

    /// The subfolder `textures`, where Poly Haven's archives have their maps.
    pub(crate) fn textures(&self) -> Result<Option<Files>, Error> {
        if self.held.is_some() {
            return Ok(None);
        }
        let mut folders = entries(&self.folder, Path::is_dir)?;
        folders.sort();
        let textures = folders.into_iter().find(|name| name.eq_ignore_ascii_case("textures"));
        Ok(textures.map(|name| Files::on_disk(&self.folder.join(name))))
    }

    pub(crate) fn get(&self, name: &str) -> Result<Bytes, Error> {
        let path = self.folder.join(name);
        match &self.held {
            None => Bytes::of_file(&path),
            Some(held) => match held.get(name) {
                Some(bytes) => Ok(Bytes::held(&path, bytes.clone())),
                None => {
                    let source = std::io::Error::from(std::io::ErrorKind::NotFound);
                    Err(Error::Read { path, source })
                }
            },
        }
    }
}

/// Names that are no Unicode are left out: no source of textures has such.
fn entries(folder: &Path, is_wanted: fn(&Path) -> bool) -> Result<Vec<String>, Error> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(Error::read(folder))? {
        let entry = entry.map_err(Error::read(folder))?;
        if let Ok(name) = entry.file_name().into_string()
            && is_wanted(&entry.path())
        {
            names.push(name);
        }
    }
    Ok(names)
}
