//! `flip.v1.Policies`.

use super::convert::{all, page};
use super::proto::*;
use super::{Service, read, write};
use futures::StreamExt;
use futures::stream::{self, BoxStream};
use tonic::{Request, Response, Status};

/// Chunk size of a download, bytes; gRPC clients refuse messages above 4 MiB.
pub(super) const CHUNK_BYTES: usize = 256 * 1024;

#[tonic::async_trait]
impl policies_server::Policies for Service {
    async fn list_policies(
        &self,
        request: Request<ListPoliciesRequest>,
    ) -> Result<Response<ListPoliciesResponse>, Status> {
        let found = self.app.policies(page(read(request)?.page)).await?;
        let found = self.app.all_labelled(found).await?;
        Ok(Response::new(ListPoliciesResponse { items: all(found.items), next: found.next }))
    }

    async fn get_policy(
        &self,
        request: Request<GetPolicyRequest>,
    ) -> Result<Response<Policy>, Status> {
        let found = self.app.policy(&read(request)?.id).await?;
        Ok(Response::new(self.app.labelled(found).await?.into()))
    }

    async fn import_policy(
        &self,
        request: Request<ImportPolicyRequest>,
    ) -> Result<Response<Policy>, Status> {
        let (found, _) = self.app.import_policy("file", &write(request)?.file).await?;
        Ok(Response::new(self.app.labelled(found).await?.into()))
    }

    type DownloadWeightsStream = BoxStream<'static, Result<DownloadWeightsResponse, Status>>;

    async fn download_weights(
        &self,
        request: Request<DownloadWeightsRequest>,
    ) -> Result<Response<Self::DownloadWeightsStream>, Status> {
        let bytes = self.app.policy_bytes(&read(request)?.id).await?;
        let chunks: Vec<_> = bytes.chunks(CHUNK_BYTES).map(<[u8]>::to_vec).collect();
        Ok(Response::new(
            stream::iter(chunks).map(|chunk| Ok(DownloadWeightsResponse { chunk })).boxed(),
        ))
    }
}
