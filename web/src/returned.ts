/** What a provider of log-ins sent back with the browser. It leaves the address at once: neither the history nor a reload may keep it. */
const answer = new URLSearchParams(location.search)

export const returned = answer.has('state') ? answer : undefined
if (returned) history.replaceState(null, '', `/${location.hash}`)
