//! Access control.

use std::hint::black_box;

use hyper::header::{HOST, HeaderMap, HeaderName, ORIGIN};

use crate::error::RequestError;

/// Header with the kind of page that sent a request. Browsers set it, and pages cannot change it.
const SEC_FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");

const TOKEN_BYTES: usize = 32;

#[derive(Debug)]
pub(crate) struct RequestAuth {
    token: String,
    hosts: [String; 2],
}

impl RequestAuth {
    pub(crate) fn new(port: u16) -> Result<Self, getrandom::Error> {
        let mut bytes = [0; TOKEN_BYTES];
        getrandom::fill(&mut bytes)?;
        let token = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        Ok(Self {
            token,
            hosts: ["127.0.0.1", "localhost"].map(|name| format!("{name}:{port}")),
        })
    }

    /// Returns the secret URL of the first page.
    pub(crate) fn url(&self) -> String {
        let [host, _] = &self.hosts;
        format!("http://{host}/{}/", self.token)
    }

    /// Checks a request and returns the path after the token.
    pub(crate) fn authorize<'p>(
        &self,
        path: &'p str,
        headers: &HeaderMap,
    ) -> Result<&'p str, RequestError> {
        let text = path.strip_prefix('/').unwrap_or_default();
        let (token, rest) = text.split_once('/').unwrap_or((text, ""));
        if !is_equal_constant_time(token.as_bytes(), self.token.as_bytes()) {
            return Err(RequestError::Forbidden(
                "the address lacks the token: use the address that crumple printed at its start",
            ));
        }
        let is_own_host =
            matches!(header_values(headers, &HOST)[..], [host] if self.is_own_host(host));
        if !is_own_host {
            return Err(RequestError::Forbidden(
                "the request names another host: use the address that crumple printed",
            ));
        }
        let is_own_page = header_values(headers, &ORIGIN).iter().all(|origin| {
            origin
                .strip_prefix("http://")
                .is_some_and(|host| self.is_own_host(host))
        });
        let is_own_site = header_values(headers, &SEC_FETCH_SITE)
            .iter()
            .all(|site| ["same-origin", "none"].contains(site));
        if !is_own_page || !is_own_site {
            return Err(RequestError::Forbidden(
                "the request comes from a page of another origin",
            ));
        }
        Ok(rest)
    }

    fn is_own_host(&self, host: &str) -> bool {
        self.hosts.iter().any(|own| own.eq_ignore_ascii_case(host))
    }
}

/// Returns the values of a header; empty for those that are not text.
fn header_values<'h>(headers: &'h HeaderMap, name: &HeaderName) -> Vec<&'h str> {
    headers
        .get_all(name)
        .iter()
        .map(|value| value.to_str().unwrap_or_default())
        .collect()
}

fn is_equal_constant_time(text: &[u8], wanted: &[u8]) -> bool {
    let difference = text
        .iter()
        .zip(wanted)
        .fold(0, |difference, (a, b)| black_box(difference | (a ^ b)));
    text.len() == wanted.len() && difference == 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use hyper::header::HeaderValue;
    use proptest::prelude::*;

    fn headers(named: &[(&'static str, &str)]) -> HeaderMap {
        let pair = |(name, value): &(&'static str, &str)| {
            (
                HeaderName::from_static(name),
                HeaderValue::from_str(value).unwrap(),
            )
        };
        named.iter().map(pair).collect()
    }

    #[test]
    fn tokens_are_long_and_differ() {
        let [first, second] = [RequestAuth::new(1).unwrap(), RequestAuth::new(1).unwrap()];
        assert_eq!(first.token.len(), 2 * TOKEN_BYTES);
        assert_ne!(first.token, second.token);
    }

    #[test]
    fn only_requests_of_the_own_page_are_authorized() {
        let gate = RequestAuth::new(8080).unwrap();
        let path = format!("/{}/api/run", gate.token);
        let own = ("host", "127.0.0.1:8080");
        let admitted = |path: &str, named: &[(&'static str, &str)]| {
            gate.authorize(path, &headers(named))
                .map(str::to_owned)
                .ok()
        };
        let let_in: [&[_]; 5] = [
            &[own],
            &[("host", "LocalHost:8080")],
            &[own, ("origin", "http://127.0.0.1:8080")],
            &[
                own,
                ("origin", "http://localhost:8080"),
                ("sec-fetch-site", "same-origin"),
            ],
            &[own, ("sec-fetch-site", "none")],
        ];
        for named in let_in {
            assert_eq!(
                admitted(&path, named).as_deref(),
                Some("api/run"),
                "{named:?}"
            );
        }
        let kept_out: [&[_]; 12] = [
            &[],
            &[("host", "127.0.0.1")],
            &[("host", "127.0.0.1:8081")],
            &[("host", "rebound.example:8080")],
            &[own, own],
            &[own, ("origin", "http://evil.example")],
            &[own, ("origin", "null")],
            &[own, ("origin", "https://127.0.0.1:8080")],
            &[own, ("origin", "http://127.0.0.1:8080.evil.example")],
            &[own, ("origin", "http://127.0.0.1:9999")],
            &[own, ("sec-fetch-site", "same-site")],
            &[own, ("sec-fetch-site", "cross-site")],
        ];
        for named in kept_out {
            assert_eq!(admitted(&path, named), None, "{named:?}");
        }
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        /// Any other text in place of the token is refused.
        #[test]
        fn any_text_but_the_token_is_refused(
            path in "/?[0-9a-f]{0,70}(/[a-z/.]{0,20})?",
            change in 0..64_usize,
            to in "[0-9a-f]",
        ) {
            let gate = RequestAuth::new(80).unwrap();
            let own = headers(&[("host", "127.0.0.1:80")]);
            prop_assert!(gate.authorize(&path, &own).is_err());
            let mut token = gate.token.clone();
            token.replace_range(change..=change, &to);
            prop_assert_eq!(gate.authorize(&format!("/{token}/"), &own).is_ok(), token == gate.token);
            let cut = format!("/{}/", &gate.token[..change]);
            prop_assert!(gate.authorize(&cut, &own).is_err());
        }
    }
}
