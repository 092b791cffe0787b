import type { Dashboard, Panel, RowPanel } from "@grafana/schema";
import type * as bargauge from "@grafana/schema/dist/esm/raw/composable/bargauge/panelcfg/x/BarGaugePanelCfg_types.gen";
import type * as stat from "@grafana/schema/dist/esm/raw/composable/stat/panelcfg/x/StatPanelCfg_types.gen";
import type * as stateTimeline from "@grafana/schema/dist/esm/raw/composable/statetimeline/panelcfg/x/StateTimelinePanelCfg_types.gen";
import type * as timeseries from "@grafana/schema/dist/esm/raw/composable/timeseries/panelcfg/x/TimeSeriesPanelCfg_types.gen";

/** What JSON has in place of a type: the values of its enumerations, and only some of what has a default. */
type Json<T> = T extends string ? `${T}`
  : T extends number ? (number extends T ? number : `${T}` extends `${infer N extends number}` ? N : never)
  : T extends (infer E)[] ? Json<E>[]
  : T extends object ? { [K in keyof T]: Json<T[K]> }
  : T;
type Some<T> = T extends (infer E)[] ? E[] : T extends object ? { [K in keyof T]?: Some<T[K]> } : T;

/** A query of a Prometheus data source. */
interface Query {
  refId: string;
  expr: string;
  datasource: { type: "prometheus"; uid: string };
  legendFormat?: string;
  instant?: boolean;
  range?: boolean;
  format?: "time_series" | "table" | "heatmap";
  interval?: string;
  exemplar?: boolean;
  hide?: boolean;
}

type Of<Type extends string, Options, Custom> = Omit<Json<Panel>, "type" | "options" | "targets" | "fieldConfig"> & {
  type: Type;
  options: Some<Json<Options>>;
  targets: Query[];
  fieldConfig: Omit<NonNullable<Json<Panel>["fieldConfig"]>, "defaults"> & {
    defaults: Omit<NonNullable<Json<Panel>["fieldConfig"]>["defaults"], "custom"> & { custom?: Some<Json<Custom>> };
  };
};

export type Row = Json<RowPanel>;
export type BarGauge = Of<"bargauge", bargauge.Options, Record<string, never>>;
export type Stat = Of<"stat", stat.Options, Record<string, never>>;
export type StateTimeline = Of<"state-timeline", stateTimeline.Options, stateTimeline.FieldConfig>;
export type TimeSeries = Of<"timeseries", timeseries.Options, timeseries.FieldConfig>;
export type AnyPanel = Row | BarGauge | Stat | StateTimeline | TimeSeries;
export type Whole = Omit<Json<Dashboard>, "panels"> & { panels: AnyPanel[] };
