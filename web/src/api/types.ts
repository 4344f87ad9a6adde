/** The service's types under the names the page uses; all of them come from openapi.json. */
import type { components } from './schema'

type Schemas = components['schemas']

export type AuditRecord = Schemas['AuditRecord']
export type AuditVerification = Schemas['AuditVerification']
export type BenchStatus = Schemas['BenchStatus'] & {
  held?: { at: string; reason: string; by?: string | null } | null
  waiting?: Waiting[]
  vial?: { name?: string | null; weighing?: string | null; holds_mg?: number | null; since: string } | null
  reservation?: { owner: string; until: string } | null
  exchanges_vials?: boolean
}
export type Waiting = { id: string; powder: string; target_mg: number; vial?: string | null; state: string }
export type Calibration = Schemas['Calibration']
export type CalibrationMethod = Schemas['CalibrationMethod']
export type CalibrationRequest = Schemas['CalibrationRequest']
export type CalibrationSet = Schemas['CalibrationSet']
export type Cause = Schemas['CauseReport']
export type ClearRequest = Schemas['ClearRequest']
export type ComparedCalibration = Schemas['ComparedCalibration']
export type Comparison = Schemas['Comparison']
export type CurrentSimulator = Schemas['CurrentSimulator']
export type Curve = Schemas['Curve']
export type Episode = Schemas['Episode']
export type Evaluation = Schemas['Evaluation']
export type EvaluationRequest = Schemas['EvaluationRequest']
export type EvaluationResult = Schemas['EvaluationResult']
export type EvaluationRow = Schemas['EvaluationRow']
export type EvaluationSummary = Schemas['EvaluationSummary']
export type Event = Schemas['Event']
export type Finding = Schemas['Finding']
export type HeldOut = Schemas['HeldOut']
export type Imported = Schemas['Imported']
export type Investigation = Schemas['Investigation']
export type InvestigationRequest = Schemas['InvestigationRequest']
export type Job = Schemas['Job']
export type JobKind = Schemas['JobKind']
export type JobState = Schemas['JobState']
export type Latch = Schemas['Latch']
export type Marginal = Schemas['Marginal']
export type Measurement = Schemas['Measurement']
export type MeasuredMass = Schemas['MeasuredMass'] & { proven?: boolean | null }
export type NewMeasurement = Schemas['NewMeasurement']
export type NewPowder = Schemas['NewPowder']
export type Observation = Schemas['Observation']
export type Observed = Schemas['Observed']
export type Order = Schemas['Order']
export type Pair = Schemas['Pair']
export type ParameterSet = CalibrationSet['parameters']
export type Pile = Schemas['Pile']
export type Policy = Schemas['Policy']
export type PolicyError = Schemas['PolicyError']
export type PowderDetail = Schemas['PowderDetail']
export type Preset = Schemas['Preset']
export type Repeatability = Schemas['Repeatability']
export type RepeatabilityRequest = Schemas['RepeatabilityRequest']
export type Report = Schemas['Report']
export type ReportRow = Schemas['Row']
export type ReposeMeasurement = Schemas['ReposeMeasurement']
export type ReposeRequest = Schemas['ReposeRequest']
export type SimulatorVersion = Schemas['SimulatorVersion']
export type Tick = Schemas['Tick']
export type Training = Schemas['Training']
export type TrainingLevel = Schemas['TrainingLevel']
export type TrainingRequest = Schemas['TrainingRequest']
export type Trial = Schemas['Trial']
export type Weighing = Omit<Schemas['Weighing'], 'state' | 'measured'> & { state: Schemas['Weighing']['state'] | 'awaiting_vial'; measured?: MeasuredMass | null }
export type WeighingRequest = Schemas['WeighingRequest'] & { vial_check?: 'confirm' | 'skip' }
