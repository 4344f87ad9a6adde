// The reference pages, from what they describe: `npm run reference` writes them, `npm run reference -- --check` says which are out of date.
// The command line is asked (FLIP_BIN, default ../../target/release/flip); the rest is read from web/openapi.json, proto/ and src/.
import { execFileSync } from 'node:child_process'
import fs from 'node:fs'
import { fileURLToPath } from 'node:url'

const root = fileURLToPath(new URL('../../', import.meta.url))
const read = file => fs.readFileSync(root + file, 'utf8')
const generated = from => `<!-- Made by \`make docs-reference\` from ${from}: do not edit. -->\n`
/** Text for the cell of a table. */
const cell = text => String(text ?? '').replace(/\s+/g, ' ').replace(/(?<!\\)\|/g, '\\|').trim()
const table = (head, rows) => [`| ${head.join(' | ')} |`, `|${head.map(() => '---').join('|')}|`, ...rows.map(row => `| ${row.map(cell).join(' | ')} |`), ''].join('\n')

// ---- the command line ----

const flip = process.env.FLIP_BIN ?? `${root}target/release/flip`
const help = words => execFileSync(flip, [...words, '--help'], { encoding: 'utf8' }).trimEnd()

function commands(words = []) {
  const text = help(words)
  const list = /^Commands:\n((?: {2}.*\n?)+)/m.exec(text)?.[1] ?? ''
  const names = [...list.matchAll(/^ {2}([a-z][a-z-]*)/gm)].map(match => match[1]).filter(name => name !== 'help')
  const depth = '#'.repeat(Math.min(words.length + 1, 3))
  const own = words.length ? `${depth} flip ${words.join(' ')}\n\n\`\`\`text\n${text}\n\`\`\`\n` : `\`\`\`text\n${text}\n\`\`\`\n`
  return [own, ...names.flatMap(name => commands([...words, name]))]
}

const cli = () => `# Command line\n\n${generated('`flip … --help`')}
What every command prints for \`--help\`. With \`--json\` standard output holds one JSON document and nothing else. Exit status: 0 done,
2 bad input, which names the field or the missing prerequisite, 1 failure.\n\n${commands().join('\n')}`

// ---- REST ----

const document = () => JSON.parse(read('web/openapi.json'))
const named = ref => ref.split('/').at(-1)

function kind(schema) {
  if (!schema) return ''
  if (schema.$ref) return `[${named(schema.$ref)}](#${named(schema.$ref).toLowerCase()})`
  const either = schema.oneOf ?? schema.anyOf ?? schema.allOf
  if (either) return either.map(kind).filter(Boolean).join(' or ')
  const types = [schema.type ?? []].flat()
  if (types.includes('array')) return `list of ${kind(schema.items)}${types.includes('null') ? ' or null' : ''}`
  if (schema.enum && !schema.type) return schema.enum.map(value => `\`${value}\``).join(', ')
  if (schema.enum) return schema.enum.map(value => `\`${value}\``).join(', ')
  return types.join(' or ')
}

function bounds(schema) {
  const says = { default: 'default', minimum: 'at least', maximum: 'at most', exclusiveMinimum: 'above', exclusiveMaximum: 'below', minLength: 'shortest', maxLength: 'longest', minItems: 'fewest', maxItems: 'most' }
  return Object.entries(says).filter(([key]) => schema[key] !== undefined).map(([key, word]) => `${word} ${JSON.stringify(schema[key])}`).join(', ')
}

/** A description and the bounds behind it. */
const said = (text, limits) => (text && limits ? `${text.replace(/\.$/, '')}; ${limits}` : (text ?? limits))

/** Refusals that most operations share, each with the words that most use for it. */
function shared(operations) {
  const counts = {}
  for (const { it } of operations) {
    for (const [status, one] of Object.entries(it.responses)) {
      if (status >= '400') (counts[status] ??= {})[one.description] = (counts[status][one.description] ?? 0) + 1
    }
  }
  const most = Object.entries(counts).map(([status, texts]) => [status, ...Object.entries(texts).sort((a, b) => b[1] - a[1])[0]])
  return Object.fromEntries(most.filter(([, , count]) => count > 9).map(([status, text]) => [status, text]))
}

function operation(method, path, it, common) {
  const parameters = (it.parameters ?? []).map(one => [`\`${one.name}\``, one.in, kind(one.schema), one.required ? 'yes' : '', said(one.description, bounds(one.schema ?? {}))])
  const bodies = Object.entries(it.requestBody?.content ?? {}).map(([type, body]) => `${kind(body.schema) || 'bytes'} as \`${type}\``)
  const own = Object.entries(it.responses).filter(([status, one]) => common[status] !== one.description)
  const answers = own.map(([status, one]) => [status, one.description, Object.values(one.content ?? {}).map(body => kind(body.schema)).filter(Boolean).join(', ')])
  return [
    `### ${method.toUpperCase()} ${path}\n`,
    `${it.summary}${it.description ? `\n\n${it.description}` : ''}\n`,
    parameters.length ? table(['parameter', 'in', 'type', 'required', 'what'], parameters) : '',
    bodies.length ? `Body: ${bodies.join(' or ')}.\n` : '',
    table(['status', 'when', 'body'], answers),
  ].filter(Boolean).join('\n')
}

function schema(name, it) {
  const forms = it.oneOf ?? it.anyOf
  const fields = one => Object.entries(one.properties ?? {}).map(([field, type]) => [`\`${field}\``, kind(type), (one.required ?? []).includes(field) ? 'yes' : '', said(type.description, bounds(type))])
  const shown = one => (one.properties ? table(['field', 'type', 'required', 'what'], fields(one)) : `${kind(one)}${bounds(one) ? `, ${bounds(one)}` : ''}${one.description ? `: ${one.description}` : ''}\n`)
  const body = forms ? forms.map(shown).join('\n') : shown({ ...it, description: undefined })
  return `### ${name}\n\n${it.description ? `${it.description}\n\n` : ''}${body}`
}

function rest() {
  const { info, paths, components, tags } = document()
  const operations = Object.entries(paths).flatMap(([path, item]) => Object.entries(item).map(([method, it]) => ({ method, path, it })))
  const common = shared(operations)
  const known = tags.map(tag => tag.name)
  const others = [...new Set(operations.map(one => one.it.tags[0]))].filter(name => !known.includes(name)).map(name => ({ name }))
  const parts = [...tags, ...others].map(({ name, description }) => {
    const own = operations.filter(one => one.it.tags[0] === name)
    return `## ${name}\n\n${description ? `${description}.\n\n` : ''}${own.map(one => operation(one.method, one.path, one.it, common)).join('\n')}`
  })
  const schemas = Object.entries(components.schemas).map(([name, it]) => schema(name, it))
  return `# REST\n\n${generated('`web/openapi.json`')}\n${info.description}\n\nA running service hands the document out as \`/openapi.json\`.\n\nRefusals are [Problem](#problem) documents. What most operations share is not repeated below:\n\n${table(['status', 'when'], Object.entries(common))}\n${parts.join('\n')}\n## Schemas\n\n${schemas.join('\n')}`
}

// ---- gRPC ----

/** Comments, blocks and their lines: enough for files in the one style that proto/ has. */
function proto(file) {
  const out = []
  let comment = []
  let block = null
  for (const line of read(file).split('\n')) {
    const text = line.trim()
    const begins = /^(service|message|enum) (\w+) \{(\})?/.exec(text)
    const rpc = /^rpc (\w+)\((stream )?(\w+)\) returns \((stream )?([\w.]+)\)/.exec(text)
    const field = /^((?:optional |repeated )?[\w.<>, ]+?) (\w+) = (\d+)/.exec(text)
    const value = /^([A-Z][A-Z0-9_]*) = (\d+);/.exec(text)
    if (text.startsWith('//')) comment.push(text.replace(/^\/\/ ?/, ''))
    else if (begins) {
      block = { kind: begins[1], name: begins[2], comment: comment.join(' '), rows: [] }
      out.push(block)
      comment = []
    } else if (text.startsWith('oneof ') || text === '}') comment = []
    else if (block && rpc) block.rows.push([`\`${rpc[1]}\``, `${rpc[2] ?? ''}\`${rpc[3]}\``, `${rpc[4] ?? ''}\`${rpc[5]}\``, comment.splice(0).join(' ')])
    else if (block && block.kind === 'enum' && value) block.rows.push([`\`${value[1]}\``, value[2], comment.splice(0).join(' ')])
    else if (block && field) block.rows.push([`\`${field[2]}\``, `\`${field[1]}\``, field[3], comment.splice(0).join(' ')])
    else comment = []
  }
  return out
}

/** A message's name leads to it. */
const linked = (names, text) => text.replace(/`((?:optional |repeated )?)([\w.]+)`/g, (all, before, name) => (names.has(name) ? `${before}[\`${name}\`](#${name.toLowerCase()})` : all))

const HEADS = { service: ['call', 'takes', 'answers', 'what'], message: ['field', 'type', 'number', 'what'], enum: ['value', 'number', 'what'] }

function blocks(file) {
  const all = proto(file)
  const names = new Set(all.map(it => it.name))
  const rows = it => it.rows.map(row => row.map((text, i) => (i === 1 || (i === 2 && it.kind === 'service') ? linked(names, text) : text)))
  const one = it => `### ${it.name}\n\n${it.comment ? `${it.comment}\n\n` : ''}${it.rows.length ? table(HEADS[it.kind], rows(it)) : 'Empty.\n'}`
  const part = (title, kinds) => `## ${title}\n\n${all.filter(it => kinds.includes(it.kind)).map(one).join('\n')}`
  return `${part('Services', ['service'])}\n${part('Messages', ['message'])}\n${part('Enumerations', ['enum'])}`
}

const preamble = file => read(file).split('\nsyntax =')[0].replace(/^\/\/ ?/gm, '')
const grpc = () => `# gRPC\n\n${generated('`proto/flip/v1/flip.proto`')}\n${preamble('proto/flip/v1/flip.proto')}\nThe port is that of REST; reflection and health are there too.\n\n${blocks('proto/flip/v1/flip.proto')}`
const arm = () => `# The arm's contract\n\n${generated('`proto/flip/bench/v1/arm.proto`')}\n[Your own arm](../tutorials/your-own-arm.md) writes a driver against it.\n\n\`\`\`text\n${preamble('proto/flip/bench/v1/arm.proto').trimEnd()}\n\`\`\`\n\n${blocks('proto/flip/bench/v1/arm.proto')}`

// ---- settings ----

/** Public fields of a struct with their docstrings, and the bounds that the same file demands of them. */
function fields(file, struct) {
  const text = read(file)
  const body = new RegExp(`pub struct ${struct} \\{\\n([\\s\\S]*?)\\n\\}`).exec(text)[1]
  const bound = Object.fromEntries([...text.matchAll(/bounded\(\s*"(?:\w+\.)?(\w+)",[^;]*?,\s*([-\d._e]+),\s*([-\d._e]+|self\.\w+),\s*"(.*?)"/g)].map(([, name, lower, upper, unit]) => [name, `${lower} to ${upper} ${unit}`.trim()]))
  const rows = []
  let doc = []
  for (const line of body.split('\n').map(it => it.trim())) {
    const field = /^pub (\w+): (?:Option<)?(\w+)/.exec(line)
    if (line.startsWith('///')) doc.push(line.slice(4))
    else if (field) rows.push([`\`${field[1]}\``, bound[field[1]]?.replace(/(?<=\d)_(?=\d)/g, '').replace('self.', '').replace(/\.0\b/g, '') ?? '', [doc.splice(0).join(' '), values(text, field[2])].join(' ')])
  }
  return table(['field', 'bounds', 'what it is, its unit and its default'], rows)
}

/** What a field of this enumeration may be. */
function values(text, name) {
  const body = new RegExp(`pub enum ${name} \\{\\n([\\s\\S]*?)\\n\\}`).exec(text)?.[1]
  if (!body) return ''
  const variants = [...body.matchAll(/((?:\s*\/\/\/ .*\n)+)(?:\s*#\[.*\n)?\s*(\w+),/g)]
  const one = ([, doc, variant]) => `\`${variant.replace(/(?<!^)(?=[A-Z])/g, '_').toLowerCase()}\`: ${doc.replace(/\s*\/\/\/ /g, ' ').trim()}`
  return variants.map(one).join(' ')
}

const PARTS = [
  ['`[balance]`', 'crates/flip-bench/src/hardware/balance/settings.rs', 'Settings'],
  ['`[balance.serial]`', 'crates/flip-bench/src/hardware/line.rs', 'Serial'],
  ['`[arm]`', 'crates/flip-bench/src/hardware/bench_file.rs', 'ArmAddress'],
  ['`[gripper]` and `[gate]`', 'crates/flip-bench/src/hardware/bench_file.rs', 'PortAddress'],
  ['`[spoon]`', 'crates/flip-core/src/domain/spoon.rs', 'Spoon'],
  ['`[readings]`', 'crates/flip-bench/src/hardware/bench_file.rs', 'Readings'],
  ['`[vial]`', 'crates/flip-core/src/domain/vial.rs', 'EmptyVial'],
]

function settings() {
  const example = /```toml\n([\s\S]*?)```/.exec(read('crates/flip-bench/src/hardware/bench_file.rs').replace(/^\/\/! ?/gm, ''))[1]
  const parts = PARTS.map(([title, file, struct]) => `### ${title}\n\n${fields(file, struct)}`)
  return `# Bench file and settings\n\n${generated('the docstrings of `src/`')}
## The bench file

\`flip serve --bench FILE\`, \`flip weigh --bench FILE\` and \`flip bench … --config FILE\` read TOML. An unknown field is refused by name.
\`flip emulate lab --out FILE\` writes one that finds emulated devices.

\`\`\`toml\n${example}\`\`\`

${parts.join('\n')}
## The service

Flags of \`flip serve\` and \`flip demo\` are in [the command line](cli.md#flip-serve). Requests over REST carry their own settings, each with
default and bounds: [REST](rest.md).

## The settings file

\`--settings FILE\` or \`FLIP_SETTINGS\` names a file with defaults for the command line. A table is a command; a key is one of its long options, with dashes or
underscores. The command line goes before the environment, the environment before the file, and the file before what \`--help\` gives as default. A file with
one mistake sets nothing; \`flip config check FILE\` names every mistake.

\`\`\`toml
data_dir = "/var/lib/flip"      # every command's
[serve]                         # that of flip serve
listen = "127.0.0.1:8080"
bench = "/etc/flip/bench.toml"
\`\`\`

## Environment

| variable | what |
|---|---|
| \`FLIP_DATABASE_URL\` | the [database on a server](../operations.md), where \`--database-url\` does not name it |
| \`FLIP_ARTIFACTS\` | the [folder or bucket of the artifacts](../operations.md), where \`--artifacts\` does not name it; \`AWS_ENDPOINT\`, \`AWS_REGION\`, \`AWS_ACCESS_KEY_ID\`, \`AWS_SECRET_ACCESS_KEY\` and others lead to a bucket |
| \`FLIP_SETTINGS\` | the settings file, where \`--settings\` does not name it |
| \`FLIP_LOG\` | which log lines \`flip serve\` shows, as \`tracing\` filters: \`FLIP_LOG=flip=debug\` |
| \`FLIP_SIMD\` | for tests: forces a narrower vector unit of the processor than the widest; results are the same |
`
}

// ---- all of them ----

const pages = { cli, rest, grpc, arm, settings }
const checks = process.argv.includes('--check')
const wanted = process.argv.slice(2).filter(word => word in pages)
fs.mkdirSync(`${root}docs/reference`, { recursive: true })
const stale = (wanted.length ? wanted : Object.keys(pages)).filter(name => {
  const file = `${root}docs/reference/${name}.md`
  const made = `${pages[name]().trimEnd()}\n`
  const same = fs.existsSync(file) && fs.readFileSync(file, 'utf8') === made
  if (!checks && !same) fs.writeFileSync(file, made)
  return !same
})
if (checks && stale.length) {
  console.error(`out of date: ${stale.map(name => `docs/reference/${name}.md`).join(', ')}: run make docs-reference`)
  process.exit(1)
}
