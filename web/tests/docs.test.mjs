/** The generated pages of the documentation say what the program, its interfaces and its settings are now. */
import assert from 'node:assert/strict'
import { spawnSync } from 'node:child_process'
import { test } from 'node:test'
import { fileURLToPath } from 'node:url'

const at = (file) => fileURLToPath(new URL(file, import.meta.url))

test('the reference pages are those of this program', () => {
  const flip = process.env.FLIP_BIN ?? at('../../target/release/flip')
  const checked = spawnSync(process.execPath, [at('../docs/reference.mjs'), '--check'], { encoding: 'utf8', env: { ...process.env, FLIP_BIN: flip } })
  assert.equal(checked.status, 0, checked.stderr)
})
