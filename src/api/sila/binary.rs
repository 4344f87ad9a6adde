//! Binary transfer: values over 2 MiB travel in chunks, before a command or after it.
//!
//! What is under way is kept in memory, within limits, and forgotten ten minutes after its last
//! chunk.

use super::Sila;
use super::error::{Call, aborted, may};
use super::execution::Values;
use super::standard::binary::Union;
use super::standard::binary_download_server::BinaryDownload;
use super::standard::binary_transfer_error::ErrorType;
use super::standard::binary_upload_server::BinaryUpload;
use super::standard::{
    Binary, BinaryTransferError, CreateBinaryRequest, CreateBinaryResponse, DeleteBinaryRequest,
    DeleteBinaryResponse, GetBinaryInfoRequest, GetBinaryInfoResponse, GetChunkRequest,
    GetChunkResponse, UploadChunkRequest, UploadChunkResponse,
};
use super::value::duration;
use crate::app::Role;
use futures::StreamExt;
use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tonic::{Request, Response, Status, Streaming};
use uuid::Uuid;

/// Largest value that travels within a message, bytes, as the standard has it.
const INLINE_MAX: usize = 2 * 1024 * 1024;
/// Largest value, bytes.
const BINARY_MAX: usize = 64 * 1024 * 1024;
/// Memory for all values under way, bytes.
const ALL_MAX: usize = 2 * BINARY_MAX;
/// Most chunks of a value.
const CHUNKS_MAX: u32 = 4096;
/// How long a value is kept after its last chunk.
const LIFE: Duration = Duration::from_secs(10 * 60);

/// Values under way, by their transfer's UUID.
#[derive(Default)]
pub struct Binaries(Mutex<HashMap<Uuid, Held>>);

/// A value under way; an answer is one whose chunks have all come.
struct Held {
    bytes: usize,
    chunks: Vec<Option<Vec<u8>>>,
    touched: Instant,
}

impl Binaries {
    /// A value that a caller gave for a parameter.
    ///
    /// # Errors
    /// A validation error if it is missing, or was not uploaded in whole.
    pub fn given(
        &self,
        call: &Call,
        parameter: &str,
        given: Option<Binary>,
    ) -> Result<Vec<u8>, Status> {
        match given.and_then(|it| it.union) {
            Some(Union::Value(bytes)) => Ok(bytes),
            Some(Union::BinaryTransferUuid(uuid)) => {
                let unknown = || call.invalid(parameter, "is no value that was uploaded in whole");
                self.whole(&uuid).ok_or_else(unknown)
            }
            None => Err(call.missing(parameter)),
        }
    }

    /// A value in an answer, within the message if it fits.
    pub fn answer(&self, bytes: Vec<u8>) -> Binary {
        let union = match bytes.len() > INLINE_MAX {
            false => Union::Value(bytes),
            true => {
                let held =
                    Held { bytes: bytes.len(), chunks: vec![Some(bytes)], touched: Instant::now() };
                let uuid = Uuid::now_v7();
                let mut all = self.all();
                make_room(&mut all, held.bytes);
                all.insert(uuid, held);
                Union::BinaryTransferUuid(uuid.to_string())
            }
        };
        Binary { union: Some(union) }
    }

    fn begin(&self, asked: &CreateBinaryRequest) -> Result<Uuid, Status> {
        let bytes = usize::try_from(asked.binary_size).unwrap_or(usize::MAX);
        if bytes > BINARY_MAX || asked.chunk_count > CHUNKS_MAX {
            let advice = format!(
                "a value may hold {BINARY_MAX} bytes in {CHUNKS_MAX} chunks, and this one has {bytes} in {}",
                asked.chunk_count
            );
            return Err(failed(ErrorType::BinaryUploadFailed, advice));
        }
        let mut all = self.all();
        if used(&all) + bytes > ALL_MAX {
            let advice = "too many values are under way: try again in a moment";
            return Err(failed(ErrorType::BinaryUploadFailed, advice));
        }
        let chunks = vec![None; asked.chunk_count as usize];
        let uuid = Uuid::now_v7();
        all.insert(uuid, Held { bytes, chunks, touched: Instant::now() });
        Ok(uuid)
    }

    fn add(&self, chunk: UploadChunkRequest) -> Result<UploadChunkResponse, Status> {
        let UploadChunkRequest { binary_transfer_uuid, chunk_index, payload } = chunk;
        let mut all = self.all();
        let held = find(&mut all, &binary_transfer_uuid)?;
        let come: usize = held.chunks.iter().flatten().map(Vec::len).sum();
        let bytes = held.bytes;
        let place = held.chunks.get_mut(chunk_index as usize).filter(|it| it.is_none());
        let Some(place) = place.filter(|_| come + payload.len() <= bytes) else {
            let advice = format!("chunk {chunk_index} is none of the value, or has come before");
            return Err(failed(ErrorType::BinaryUploadFailed, advice));
        };
        *place = Some(payload);
        let lifetime_of_binary = Some(duration(LIFE.as_secs_f64()));
        Ok(UploadChunkResponse { binary_transfer_uuid, chunk_index, lifetime_of_binary })
    }

    fn chunk(&self, asked: GetChunkRequest) -> Result<GetChunkResponse, Status> {
        let GetChunkRequest { binary_transfer_uuid, offset, length } = asked;
        let mut all = self.all();
        let held = find(&mut all, &binary_transfer_uuid)?;
        let whole = held.chunks.first().and_then(Option::as_ref).filter(|_| held.is_answer());
        let begin = usize::try_from(offset).unwrap_or(usize::MAX);
        let payload = whole.and_then(|it| it.get(begin..begin.checked_add(length as usize)?));
        let Some(payload) = payload.filter(|it| it.len() <= INLINE_MAX) else {
            let advice = format!("{length} bytes from {offset} on are not in the value");
            return Err(failed(ErrorType::BinaryDownloadFailed, advice));
        };
        let payload = payload.to_vec();
        let lifetime_of_binary = Some(duration(LIFE.as_secs_f64()));
        Ok(GetChunkResponse { binary_transfer_uuid, offset, payload, lifetime_of_binary })
    }

    fn bytes(&self, uuid: &str) -> Result<usize, Status> {
        Ok(find(&mut self.all(), uuid)?.bytes)
    }

    fn forget(&self, uuid: &str) -> Result<(), Status> {
        find(&mut self.all(), uuid)?;
        if let Ok(uuid) = uuid.parse() {
            self.all().remove(&uuid);
        }
        Ok(())
    }

    /// A value that was uploaded in whole. It stays, in case the command is sent again.
    fn whole(&self, uuid: &str) -> Option<Vec<u8>> {
        let mut all = self.all();
        let held = find(&mut all, uuid).ok()?;
        let chunks: Option<Vec<&Vec<u8>>> = held.chunks.iter().map(Option::as_ref).collect();
        let whole: Vec<u8> = chunks?.into_iter().flatten().copied().collect();
        Some(whole).filter(|whole| whole.len() == held.bytes)
    }

    fn all(&self) -> MutexGuard<'_, HashMap<Uuid, Held>> {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        all.retain(|_, held| held.touched.elapsed() < LIFE);
        all
    }
}

impl Held {
    fn is_answer(&self) -> bool {
        self.chunks.len() == 1
    }
}

fn used(all: &HashMap<Uuid, Held>) -> usize {
    all.values().map(|held| held.bytes).sum()
}

/// Forgets values, the longest untouched first, until so many bytes have room.
fn make_room(all: &mut HashMap<Uuid, Held>, bytes: usize) {
    while used(all) + bytes > ALL_MAX {
        let oldest = all.iter().min_by_key(|(_, held)| held.touched).map(|(uuid, _)| *uuid);
        let Some(oldest) = oldest else { return };
        all.remove(&oldest);
    }
}

fn find<'a>(all: &'a mut HashMap<Uuid, Held>, uuid: &str) -> Result<&'a mut Held, Status> {
    let held = uuid.parse().ok().and_then(|uuid: Uuid| all.get_mut(&uuid));
    let held = held.ok_or_else(|| {
        let advice = "there is no value with this UUID, or it was kept for too long";
        failed(ErrorType::InvalidBinaryTransferUuid, advice)
    })?;
    held.touched = Instant::now();
    Ok(held)
}

fn failed(kind: ErrorType, message: impl Into<String>) -> Status {
    aborted(&BinaryTransferError { error_type: kind as i32, message: message.into() })
}

#[tonic::async_trait]
impl BinaryUpload for Sila {
    async fn create_binary(
        &self,
        request: Request<CreateBinaryRequest>,
    ) -> Result<Response<CreateBinaryResponse>, Status> {
        may(request.extensions(), Role::Operator)?;
        let uuid = self.binaries.begin(request.get_ref())?;
        let lifetime_of_binary = Some(duration(LIFE.as_secs_f64()));
        let binary_transfer_uuid = uuid.to_string();
        Ok(Response::new(CreateBinaryResponse { binary_transfer_uuid, lifetime_of_binary }))
    }

    type UploadChunkStream = Values<UploadChunkResponse>;

    async fn upload_chunk(
        &self,
        request: Request<Streaming<UploadChunkRequest>>,
    ) -> Result<Response<Values<UploadChunkResponse>>, Status> {
        let binaries = self.binaries.clone();
        let added = move |chunk: Result<_, Status>| chunk.and_then(|chunk| binaries.add(chunk));
        Ok(Response::new(request.into_inner().map(added).boxed()))
    }

    async fn delete_binary(
        &self,
        request: Request<DeleteBinaryRequest>,
    ) -> Result<Response<DeleteBinaryResponse>, Status> {
        self.binaries.forget(&request.into_inner().binary_transfer_uuid)?;
        Ok(Response::new(DeleteBinaryResponse {}))
    }
}

#[tonic::async_trait]
impl BinaryDownload for Sila {
    async fn get_binary_info(
        &self,
        request: Request<GetBinaryInfoRequest>,
    ) -> Result<Response<GetBinaryInfoResponse>, Status> {
        let bytes = self.binaries.bytes(&request.into_inner().binary_transfer_uuid)?;
        let lifetime_of_binary = Some(duration(LIFE.as_secs_f64()));
        let binary_size = bytes as u64;
        Ok(Response::new(GetBinaryInfoResponse { binary_size, lifetime_of_binary }))
    }

    type GetChunkStream = Values<GetChunkResponse>;

    async fn get_chunk(
        &self,
        request: Request<Streaming<GetChunkRequest>>,
    ) -> Result<Response<Values<GetChunkResponse>>, Status> {
        let binaries = self.binaries.clone();
        let taken = move |asked: Result<_, Status>| asked.and_then(|asked| binaries.chunk(asked));
        Ok(Response::new(request.into_inner().map(taken).boxed()))
    }

    async fn delete_binary(
        &self,
        request: Request<DeleteBinaryRequest>,
    ) -> Result<Response<DeleteBinaryResponse>, Status> {
        self.binaries.forget(&request.into_inner().binary_transfer_uuid)?;
        Ok(Response::new(DeleteBinaryResponse {}))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::api::sila::feature::DISCOVERY;

    const CALL: Call =
        Call { feature: DISCOVERY, command: "Investigate", parameters: &[], errors: &[] };

    fn given(binaries: &Binaries, uuid: Uuid) -> Result<Vec<u8>, Status> {
        let union = Some(Union::BinaryTransferUuid(uuid.to_string()));
        binaries.given(&CALL, "Campaign", Some(Binary { union }))
    }

    #[test]
    fn an_upload_counts_once_all_its_chunks_have_come() {
        let binaries = Binaries::default();
        let asked = CreateBinaryRequest {
            binary_size: 5,
            chunk_count: 2,
            parameter_identifier: String::new(),
        };
        let uuid = binaries.begin(&asked).unwrap();
        let chunk = |chunk_index, payload: &[u8]| UploadChunkRequest {
            binary_transfer_uuid: uuid.to_string(),
            chunk_index,
            payload: payload.to_vec(),
        };
        binaries.add(chunk(1, b"de")).unwrap();
        assert!(given(&binaries, uuid).is_err());
        assert!(binaries.add(chunk(1, b"de")).is_err() && binaries.add(chunk(2, b"")).is_err());
        assert!(binaries.add(chunk(0, b"abcd")).is_err(), "more than announced");
        binaries.add(chunk(0, b"abc")).unwrap();
        assert_eq!(given(&binaries, uuid).unwrap(), b"abcde");
        binaries.forget(&uuid.to_string()).unwrap();
        assert!(given(&binaries, uuid).is_err());
    }

    #[test]
    fn a_large_answer_is_fetched_in_chunks_and_a_small_one_is_there() {
        let binaries = Binaries::default();
        assert_eq!(binaries.answer(b"abc".to_vec()).union, Some(Union::Value(b"abc".to_vec())));
        let Some(Union::BinaryTransferUuid(uuid)) = binaries.answer(vec![7; INLINE_MAX + 1]).union
        else {
            panic!("within the message");
        };
        let part = |offset, length| {
            let binary_transfer_uuid = uuid.clone();
            binaries.chunk(GetChunkRequest { binary_transfer_uuid, offset, length })
        };
        assert_eq!(part(INLINE_MAX as u64, 1).unwrap().payload, [7]);
        assert!(part(INLINE_MAX as u64, 2).is_err() && part(u64::MAX, 1).is_err());
    }

    #[test]
    fn values_under_way_share_their_memory() {
        let binaries = Binaries::default();
        let asked = CreateBinaryRequest {
            binary_size: BINARY_MAX as u64,
            chunk_count: 1,
            parameter_identifier: String::new(),
        };
        let first = binaries.begin(&asked).unwrap();
        binaries.begin(&asked).unwrap();
        assert!(binaries.begin(&asked).is_err());
        binaries.forget(&first.to_string()).unwrap();
        assert!(binaries.begin(&asked).is_ok());
        let more = CreateBinaryRequest { binary_size: BINARY_MAX as u64 + 1, ..asked };
        assert!(Binaries::default().begin(&more).is_err());
    }
}
