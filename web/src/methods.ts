/** Names of the methods by which calibrations search for sets. */
const METHODS: Record<string, string> = { emulator: 'Shared emulator', paper: 'Published method', sequential: 'Sequential' }

export const methodName = (method: unknown): string => METHODS[String(method)] ?? String(method)
