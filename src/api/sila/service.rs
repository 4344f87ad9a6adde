//! SiLAService: who the server is and what it can do.

use super::error::{Call, undefined};
use super::feature::{SERVICE, all};
use super::proto::sila2::org::silastandard::core::silaservice::v1::si_la_service_server::SiLaService;
use super::proto::sila2::org::silastandard::core::silaservice::v1::*;
use super::value::text;
use super::{Sila, operate};
use tonic::{Request, Response, Status};

/// Kind of server.
const KIND: &str = "PowderDoser";
/// What the server is for.
pub const DESCRIPTION: &str = "Weighs powders by the milligram with a robot that it trains in simulation, and measures how they pile.";
/// The publication that FLIP follows.
const VENDOR_URL: &str = "https://arxiv.org/abs/2506.03896";
/// Most bytes of a name.
const NAME_MAX: usize = 255;

const SET_NAME: Call =
    Call { feature: SERVICE, command: "SetServerName", parameters: &[], errors: &[] };
const DEFINITION: Call =
    Call { feature: SERVICE, command: "GetFeatureDefinition", parameters: &[], errors: &[] };

#[tonic::async_trait]
impl SiLaService for Sila {
    async fn get_feature_definition(
        &self,
        request: Request<GetFeatureDefinitionParameters>,
    ) -> Result<Response<GetFeatureDefinitionResponses>, Status> {
        self.definition(request.into_inner())
    }

    async fn set_server_name(
        &self,
        request: Request<SetServerNameParameters>,
    ) -> Result<Response<SetServerNameResponses>, Status> {
        self.rename(operate(request)?)
    }

    async fn get_implemented_features(
        &self,
        _: Request<GetImplementedFeaturesParameters>,
    ) -> Result<Response<GetImplementedFeaturesResponses>, Status> {
        let features = all(self.lock.is_some()).filter_map(|it| text(it.identifier));
        let implemented_features = features.collect();
        Ok(Response::new(GetImplementedFeaturesResponses { implemented_features }))
    }

    async fn get_server_name(
        &self,
        _: Request<GetServerNameParameters>,
    ) -> Result<Response<GetServerNameResponses>, Status> {
        Ok(Response::new(GetServerNameResponses { server_name: text(self.plate.name()) }))
    }

    async fn get_server_type(
        &self,
        _: Request<GetServerTypeParameters>,
    ) -> Result<Response<GetServerTypeResponses>, Status> {
        Ok(Response::new(GetServerTypeResponses { server_type: text(KIND) }))
    }

    async fn get_server_uuid(
        &self,
        _: Request<GetServerUuidParameters>,
    ) -> Result<Response<GetServerUuidResponses>, Status> {
        Ok(Response::new(GetServerUuidResponses {
            server_uuid: text(self.plate.uuid().to_string()),
        }))
    }

    async fn get_server_description(
        &self,
        _: Request<GetServerDescriptionParameters>,
    ) -> Result<Response<GetServerDescriptionResponses>, Status> {
        Ok(Response::new(GetServerDescriptionResponses { server_description: text(DESCRIPTION) }))
    }

    async fn get_server_version(
        &self,
        _: Request<GetServerVersionParameters>,
    ) -> Result<Response<GetServerVersionResponses>, Status> {
        Ok(Response::new(GetServerVersionResponses {
            server_version: text(env!("CARGO_PKG_VERSION")),
        }))
    }

    async fn get_server_vendor_url(
        &self,
        _: Request<GetServerVendorUrlParameters>,
    ) -> Result<Response<GetServerVendorUrlResponses>, Status> {
        Ok(Response::new(GetServerVendorUrlResponses { server_vendor_url: text(VENDOR_URL) }))
    }
}

impl Sila {
    fn definition(
        &self,
        asked: GetFeatureDefinitionParameters,
    ) -> Result<Response<GetFeatureDefinitionResponses>, Status> {
        let asked = DEFINITION.text("FeatureIdentifier", asked.feature_identifier)?;
        let mut known = all(self.lock.is_some());
        let found = known.find(|feature| feature.identifier.eq_ignore_ascii_case(&asked));
        let found = found.ok_or_else(|| {
            let advice = "the property ImplementedFeatures lists those of this server";
            DEFINITION.defined("UnimplementedFeature", advice)
        })?;
        let feature_definition = text(found.definition);
        Ok(Response::new(GetFeatureDefinitionResponses { feature_definition }))
    }

    fn rename(
        &self,
        asked: SetServerNameParameters,
    ) -> Result<Response<SetServerNameResponses>, Status> {
        let name = SET_NAME.text("ServerName", asked.server_name)?;
        let name = name.trim();
        if name.is_empty() || name.len() > NAME_MAX || name.chars().any(char::is_control) {
            let advice = format!("must be one line of 1 to {NAME_MAX} bytes");
            return Err(SET_NAME.invalid("ServerName", advice));
        }
        self.plate.set_name(name).map_err(|error| undefined(error.to_string()))?;
        Ok(Response::new(SetServerNameResponses {}))
    }
}
