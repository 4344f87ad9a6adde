//! Every list of a data folder or of a server in files, for `flip export`.
//!
//! The lists are asked for as a viewer would ask over REST, so the files have the same columns as
//! `?format=csv` and nothing that a viewer may not see.

use super::columns::{Column, Kind, columns};
use super::{DOCUMENT, PAGE_BYTES_MAX, ROWS, Writer, is_list};
use crate::api::auth::Caller;
use crate::app::App;
use axum::body::{Body, to_bytes};
use axum::extract::Request;
use axum::{Extension, Router};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fs::{File, create_dir_all, read_dir, rename, write};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use tower::ServiceExt;

pub use super::Format;

/// Lists that are no results: what admins see, and who computes at the moment.
const NO_RESULTS: [&str; 4] = ["/v1/benches", "/v1/tokens", "/v1/webhooks", "/v1/workers"];

/// What an export wrote.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Exported {
    /// The folder.
    pub out: PathBuf,
    /// Rows of each table, by file name.
    pub rows: BTreeMap<String, usize>,
    /// Policy files.
    pub policies: usize,
    /// What is missing because its file is lost or damaged.
    pub lost: Vec<String>,
}

/// Why nothing was exported.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The folder exists and is not empty.
    #[error("{} is not empty", .0.display())]
    NotEmpty(PathBuf),
    /// It cannot be written.
    #[error("{}: {}", .0.display(), .1)]
    Unwritable(PathBuf, std::io::Error),
    /// A list was refused.
    #[error("{path} was answered with {status}")]
    Refused {
        /// The list.
        path: String,
        /// The answer's status.
        status: u16,
    },
    /// A list has no table.
    #[error("{0}")]
    Broken(axum::BoxError),
}

/// Where the lists are asked for.
pub trait Source {
    /// Status and body of the answer to a GET of a path.
    ///
    /// # Errors
    /// There is no answer.
    fn get(&self, target: &str) -> impl Future<Output = Result<(u16, Vec<u8>), ExportError>>;
}

/// The lists of a data folder.
pub struct Folder(Router);

impl Folder {
    /// Those of the folder that this application has open.
    pub fn of(app: App) -> Self {
        Self(super::super::router(app).layer(Extension(Caller::Anonymous { may_read: true })))
    }
}

impl Source for Folder {
    async fn get(&self, target: &str) -> Result<(u16, Vec<u8>), ExportError> {
        let request = Request::get(target).body(Body::empty());
        let request = request.map_err(|error| ExportError::Broken(error.into()))?;
        let Ok(response) = self.0.clone().oneshot(request).await;
        let status = response.status().as_u16();
        let bytes = to_bytes(response.into_body(), PAGE_BYTES_MAX).await;
        Ok((status, bytes.map_err(|error| ExportError::Broken(error.into()))?.into()))
    }
}

/// Writes every list into a table, and every policy's file, into the folder `out`, which appears
/// complete or not at all. `told` hears of each table.
///
/// # Errors
/// [`ExportError`]; `out` must not exist, or be empty.
pub async fn export(
    source: impl Source,
    out: &Path,
    format: Format,
    mut told: impl FnMut(&str),
) -> Result<Exported, ExportError> {
    if read_dir(out).is_ok_and(|mut entries| entries.next().is_some()) {
        return Err(ExportError::NotEmpty(out.to_owned()));
    }
    let name = out.file_name().unwrap_or_default().to_string_lossy();
    let part = out.with_file_name(format!("{name}.part"));
    let unwritable = |error| ExportError::Unwritable(part.clone(), error);
    if part.exists() {
        std::fs::remove_dir_all(&part).map_err(unwritable)?;
    }
    create_dir_all(part.join("policies")).map_err(unwritable)?;
    let mut export = Export {
        source,
        folder: part.clone(),
        format,
        done: Exported {
            out: out.to_owned(),
            rows: BTreeMap::new(),
            policies: 0,
            lost: Vec::new(),
        },
    };
    let mut schema = serde_json::Map::new();
    let paths = DOCUMENT["paths"].as_object().into_iter().flat_map(|paths| paths.keys());
    // `audit.json` is `audit` in one piece.
    let exported = |path: &&String| {
        !path.contains('.') && !NO_RESULTS.contains(&path.as_str()) && is_list(&DOCUMENT, path)
    };
    for path in paths.filter(exported) {
        if let Some((file, columns)) = export.table(path).await? {
            told(&file);
            schema.insert(file, columns);
        }
    }
    export.policies().await?;
    let text = serde_json::to_vec_pretty(&schema).unwrap_or_default();
    write(part.join("columns.json"), text).map_err(unwritable)?;
    let unwritable = |error| ExportError::Unwritable(out.to_owned(), error);
    rename(&part, out).map_err(unwritable)?;
    Ok(export.done)
}

struct Export<S> {
    source: S,
    folder: PathBuf,
    format: Format,
    done: Exported,
}

impl<S: Source> Export<S> {
    /// Writes the list at a path, or the lists of that kind that all things have, and returns the
    /// file's name and columns; `None` for what is no table.
    async fn table(&mut self, path: &str) -> Result<Option<(String, Value)>, ExportError> {
        let Some(mut columns) = columns(&DOCUMENT, path) else { return Ok(None) };
        let (list, inside) = path.split_once("/{id}").unwrap_or((path, ""));
        let parts: Vec<_> = list.split('/').chain(inside.split('/')).skip(2).collect();
        let parts: Vec<_> = parts.into_iter().filter(|it| !it.is_empty()).collect();
        let parent = path.contains('{').then(|| parts[0].trim_end_matches('s').to_owned());
        if let Some(parent) = parent.clone().filter(|it| columns.iter().all(|at| at.name != *it)) {
            columns.insert(0, Column::at_top(&parent, Kind::Text));
        }
        let of = match &parent {
            None => vec![None],
            Some(_) => self.ids(list).await?.into_iter().map(Some).collect(),
        };
        let file = format!("{}.{}", parts.join("-"), self.format.extension());
        let target = self.folder.join(&file);
        let unwritable = |error| ExportError::Unwritable(target.clone(), error);
        let mut into = None;
        let mut rows = 0;
        for id in of {
            let path = id.as_ref().map_or(path.to_owned(), |id| path.replace("{id}", id));
            let mut after = None;
            loop {
                let (mut page, next) = match self.page(&path, after.as_deref()).await? {
                    Answer::Page(page, next) => (page, next),
                    Answer::Lost => {
                        self.done.lost.push(path.clone());
                        break;
                    }
                };
                if let (Some(parent), Some(id)) = (&parent, &id) {
                    page.iter_mut().for_each(|row| row[parent] = id.as_str().into());
                }
                let (writer, out) = match &mut into {
                    Some(open) => open,
                    None => into.insert(self.begin(&target, &columns)?),
                };
                rows += page.len();
                let bytes = writer.rows(&columns, &page).map_err(ExportError::Broken)?;
                out.write_all(&bytes).map_err(unwritable)?;
                after = next;
                if after.is_none() {
                    break;
                }
            }
        }
        let (mut writer, mut out) = match into {
            Some(open) => open,
            None => self.begin(&target, &columns)?,
        };
        // A table without rows has its header.
        if rows == 0 {
            let header = writer.rows(&columns, &[]).map_err(ExportError::Broken)?;
            out.write_all(&header).map_err(unwritable)?;
        }
        let end = writer.end().map_err(ExportError::Broken)?;
        out.write_all(&end).and_then(|()| out.flush()).map_err(unwritable)?;
        self.done.rows.insert(file.clone(), rows);
        let columns = columns.iter().map(|it| json!({ "name": it.name, "kind": it.kind.name() }));
        Ok(Some((file, columns.collect())))
    }

    fn begin(
        &self,
        target: &Path,
        columns: &[Column],
    ) -> Result<(Writer, BufWriter<File>), ExportError> {
        let writer = Writer::begin(self.format, columns).map_err(ExportError::Broken)?;
        let file = File::create(target)
            .map_err(|error| ExportError::Unwritable(target.to_owned(), error))?;
        Ok((writer, BufWriter::new(file)))
    }

    /// The ids of everything on a list.
    async fn ids(&self, list: &str) -> Result<Vec<String>, ExportError> {
        let (mut ids, mut after) = (Vec::new(), None);
        loop {
            let Answer::Page(page, next) = self.page(list, after.as_deref()).await? else {
                return Ok(ids);
            };
            // What a job makes has its job's id.
            let id =
                |row: &Value| row["id"].as_str().or(row["job"]["id"].as_str()).map(str::to_owned);
            ids.extend(page.iter().filter_map(id));
            after = next;
            if after.is_none() {
                return Ok(ids);
            }
        }
    }

    async fn policies(&mut self) -> Result<(), ExportError> {
        for id in self.ids("/v1/policies").await? {
            let path = format!("/v1/policies/{id}/weights");
            match self.source.get(&path).await? {
                (200, bytes) => {
                    let target = self.folder.join("policies").join(format!("{id}.safetensors"));
                    write(&target, bytes)
                        .map_err(|error| ExportError::Unwritable(target.clone(), error))?;
                    self.done.policies += 1;
                }
                (410, _) => self.done.lost.push(path),
                (status, _) => return Err(ExportError::Refused { path, status }),
            }
        }
        Ok(())
    }

    /// A page of a list, archived things among the others.
    async fn page(&self, path: &str, after: Option<&str>) -> Result<Answer, ExportError> {
        let mut query = form_urlencoded::Serializer::new(String::new());
        let takes = |name: &str| {
            let known = DOCUMENT["paths"].as_object().into_iter().flatten();
            let mut known = known.filter(|(pattern, _)| is_of(path, pattern));
            known.any(|(_, item)| {
                let parameters = item["get"]["parameters"].as_array();
                parameters.is_some_and(|all| all.iter().any(|it| it["name"] == name))
            })
        };
        for (name, value) in [("limit", ROWS), ("archived", "include")] {
            if takes(name) {
                query.append_pair(name, value);
            }
        }
        if let Some(after) = after {
            query.append_pair("after", after);
        }
        let (status, bytes) = self.source.get(&format!("{path}?{}", query.finish())).await?;
        match status {
            200 => {}
            404 | 410 => return Ok(Answer::Lost),
            status => return Err(ExportError::Refused { path: path.to_owned(), status }),
        }
        let answer = serde_json::from_slice(&bytes).map_err(|it| ExportError::Broken(it.into()))?;
        Ok(match answer {
            Value::Array(items) => Answer::Page(items, None),
            mut page => {
                let next = page["next"].as_str().map(str::to_owned);
                let items = page["items"].as_array_mut().map(std::mem::take).unwrap_or_default();
                Answer::Page(items, next)
            }
        })
    }
}

enum Answer {
    Page(Vec<Value>, Option<String>),
    Lost,
}

/// Whether a path is one of a pattern such as `/v1/powders/{id}/measurements`.
fn is_of(path: &str, pattern: &str) -> bool {
    let (path, pattern) = (path.split('/'), pattern.split('/'));
    path.clone().count() == pattern.clone().count()
        && path.zip(pattern).all(|(part, of)| part == of || of.starts_with('{'))
}
