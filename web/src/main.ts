import { mount } from 'svelte'
import App from './App.svelte'
import { language } from './language.svelte'
import './style.css'

/** The page waits no longer than this for the texts of its language: a stop must not wait for them. */
const TEXTS_MS = 800

const target = document.getElementById('app')
if (!target) throw new Error('index.html has no #app')
// Without an await: it would make a file of its own of all that later files share with the first.
void Promise.race([language.show(language.chosen), new Promise((resolve) => setTimeout(resolve, TEXTS_MS))]).then(() => mount(App, { target }))
