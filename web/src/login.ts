/** Log-ins with the lab's own accounts: the browser goes to the provider and comes back with a code. */
import { beginLogIn, finishLogIn, whoHolds } from './api/calls'
import { LOST, Problem } from './api/problem'
import { live } from './live.svelte'
import { settings } from './settings.svelte'

const BEGUN = 'flip-login'

interface Begun {
  state: string
  /** Never leaves this tab: without it the code in the address opens nothing. */
  secret: string
  /** The view to come back to. */
  hash: string
}

/** Leaves for the provider. */
export async function logIn() {
  const { url, state, secret } = await beginLogIn()
  const begun: Begun = { state, secret, hash: location.hash }
  sessionStorage.setItem(BEGUN, JSON.stringify(begun))
  location.assign(url)
}

/** Takes up what the provider sent back; a refusal is shown where a person logs in. */
export async function logInReturned(answer: URLSearchParams) {
  const begun = JSON.parse(sessionStorage.getItem(BEGUN) ?? 'null') as Begun | null
  sessionStorage.removeItem(BEGUN)
  try {
    const state = answer.get('state') ?? ''
    if (begun?.state !== state) throw new Problem('You are not logged in', 'This log-in was not begun in this tab. Log in again.', 0)
    if (begun.hash) location.replace(begun.hash)
    const code = answer.get('code')
    if (!code) throw new Problem('You are not logged in', `The provider says: ${answer.get('error') ?? 'nothing'}. Log in again, or use a token.`, 0)
    const { secret } = await finishLogIn({ state, code, secret: begun.secret })
    settings.keep(secret, await whoHolds(secret))
    live.restart()
  } catch (error) {
    settings.refuse(Problem.of(error, LOST.once))
  }
}
