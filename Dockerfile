# FLIP in a container (x86-64). The data folder is the volume /data; docs/how-to/install.md says how to run it.
#
#   docker build -t flip .
#   docker run --rm -v flip-data:/data -p 127.0.0.1:8080:8080 flip
#
# Without training, which alone needs libtorch, 440 MB smaller: docker build --build-arg TRAINING=no -t flip:slim .

# The page and the documentation, which the binary embeds.
FROM node:20-bookworm-slim AS page
WORKDIR /flip/web
COPY web/package.json web/package-lock.json ./
RUN npm ci --no-fund --no-audit
COPY web/docs/package.json web/docs/package-lock.json docs/
RUN cd docs && npm ci --no-fund --no-audit
COPY web ./
COPY docs ../docs
RUN npm run build && cd docs && npm run build

# The program. libtorch first: it is the largest download and changes least.
FROM rust:1.95-bookworm AS program
RUN apt-get update \
    && apt-get install -y --no-install-recommends python3 python3-pip \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /flip
ARG TRAINING=yes
COPY .cargo .cargo
RUN [ "$TRAINING" = no ] || python3 .cargo/fetch_libtorch.py
COPY Cargo.toml Cargo.lock ./
COPY proto proto
COPY migrations migrations
COPY benches benches
COPY examples examples
COPY experiments experiments
COPY crates crates
COPY src src
# The style of reports is the page's.
COPY web/src/tokens.css web/src/report.css web/src/
COPY --from=page /flip/web/dist web/dist
COPY --from=page /flip/web/docs-dist web/docs-dist
RUN cargo build --release --locked --bin flip $([ "$TRAINING" != no ] || echo --no-default-features)
# The binary looks for its libraries in `lib` beside itself before anywhere else.
RUN mkdir -p /image/lib && cp target/release/flip /image/ && { [ "$TRAINING" = no ] || cp .libtorch/lib/*.so* /image/lib/; }

FROM debian:bookworm-slim
# The public authorities, by whom webhooks, buckets and databases are known.
RUN apt-get update \
    && apt-get install -y --no-install-recommends ca-certificates \
    && rm -rf /var/lib/apt/lists/*
COPY --from=program /image /opt/flip
RUN ln -s /opt/flip/flip /usr/local/bin/flip \
    && useradd --uid 10001 --user-group --no-create-home --shell /usr/sbin/nologin flip \
    && install -d -o flip -g flip -m 0750 /data
USER flip
VOLUME /data
EXPOSE 8080
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=30s --timeout=5s --start-period=30s CMD ["flip", "health", "--listen", "127.0.0.1:8080"]
ENTRYPOINT ["flip"]
# Loopback inside a container reaches nobody, so it listens on every address of the container, and says the flag that
# FLIP demands for readable traffic: publish the port on the host's loopback as above, or mount a certificate and give
# `serve --listen 0.0.0.0:8080 --tls-cert … --tls-key …` instead. Off loopback every call needs a token.
CMD ["serve", "--data-dir", "/data", "--listen", "0.0.0.0:8080", "--insecure-lan"]
