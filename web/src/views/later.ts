/** What src/later.svelte.ts fetches after the first view. */
export { default as Audit } from './Audit.svelte'
export { default as Grains } from './Grains.svelte'
export { default as DoseListForm } from './DoseListForm.svelte'
export { default as SimulatorChoice } from '../parts/SimulatorChoice.svelte'
export { default as LaterView } from './LaterView.svelte'
export { logIn, logInReturned } from '../login'
export { default as Plot } from 'uplot'
