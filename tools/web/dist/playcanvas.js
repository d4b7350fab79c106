/*! cogsplat, Apache-2.0 */
var v=new Uint32Array(1),O=new Float32Array(v.buffer);function g(e){O[0]=e;let o=v[0]>>>16&32768,t=Math.min(Math.abs(e),65504);if(t<2**-14)return o|Math.round(t*2**24);O[0]=t;let s=v[0];return o|s+4095+(s>>>13&1)-939524096>>>13}function w(e){let o=e&32768?-1:1,t=e>>>10&31,s=e&1023;return o*(t===0?s*2**-24:(1024+s)*2**(t-25))}function y(e,o){let t=e*Math.exp(o);return t/(t+1-e)}var P=e=>({name:e,width:4,bytes:2}),m=(e,o=4)=>({name:e,width:o,bytes:4}),b=[P("dcColor"),m("transformA"),P("transformB")],D=[b,[...b,m("splatSH_1to3")],[...b,m("splatSH_1to3"),m("splatSH_4to7"),m("splatSH_8to11",1)],[...b,m("splatSH_1to3"),m("splatSH_4to7"),m("splatSH_8to11"),m("splatSH_12to15")]];var nt=Math.log(65504);function E({arrays:e,count:o},t,s,c){let[f,,a]=e,[n,,l]=s;for(let r=0;r<o;r++){let i=4*(c+r);n[i+3]=g(y(w(f[4*r+3]),t.opacities[r]));let p=Math.exp(t.scales[r]);for(let h=0;h<3;h++)l[i+h]=g(w(a[4*r+h])*p)}}var S=(...e)=>e.map(o=>({name:o,width:4,bytes:4})),B=[S("centers","shapes"),S("centers","shapes","sh1"),S("centers","shapes","sh1","sh2"),S("centers","shapes","sh1","sh2","sh3a","sh3b")];function U({arrays:e,count:o},t,s,c){let[f,a]=e,[n,l]=s;for(let r=0;r<o;r++){let i=4*(c+r),p=h=>g(w(h)+t.scales[r]);n[i+3]=g(y(w(f[4*r+3]),t.opacities[r])),l[i+1]=a[4*r+1]&65535|p(a[4*r+1]>>>16)<<16,l[i+2]=p(a[4*r+2]&65535)|p(a[4*r+2]>>>16)<<16}}var $=new Float32Array(1),it=new Uint32Array($.buffer);function R(e,o){return(e==="spark"?B:D)[o]}function F(e,o,t){return R(e,o).map(({width:s,bytes:c})=>c===4?new Uint32Array(s*t):new Uint16Array(s*t))}function G(e,o,t,s){let{arrays:c,count:f,layout:a}=e;c.forEach((n,l)=>t[l].set(n,n.length/f*s)),o!==void 0&&(a==="spark"?U:E)(e,o,t,s)}var Q={R:"L",L:"R",U:"D",D:"U",F:"B",B:"F"};function T(e,o="RUB"){return[...o].flatMap(t=>[...e].map(s=>s===t?1:s===Q[t]?-1:0))}function I(e,o="RUB"){let t=T(e,o);if(t[0]*(t[4]*t[8]-t[5]*t[7])-t[1]*(t[3]*t[8]-t[5]*t[6])+t[2]*(t[3]*t[7]-t[4]*t[6])<0)throw new RangeError(`axes ${e} are a reflection of ${o}`);let c=[1+t[0]-t[4]-t[8],1-t[0]+t[4]-t[8],1-t[0]-t[4]+t[8],1+t[0]+t[4]+t[8]],f=c.indexOf(Math.max(...c)),a=Math.sqrt(c[f]),n=.5/a;switch(f){case 0:return[a/2,(t[1]+t[3])*n,(t[2]+t[6])*n,(t[7]-t[5])*n];case 1:return[(t[1]+t[3])*n,a/2,(t[5]+t[7])*n,(t[2]-t[6])*n];case 2:return[(t[2]+t[6])*n,(t[5]+t[7])*n,a/2,(t[3]-t[1])*n];default:return[(t[7]-t[5])*n,(t[2]-t[6])*n,(t[3]-t[1])*n,a/2]}}var j=250,J=6;function _(e,o){return Math.min(o.degree??e.info.shDegree,e.info.shDegree)}async function N(e,o,t,s,c){let f=s.compensate??!0,a=new k(e,t,f),n=new L,l=-1/0,r=e.stream({...s,degree:_(e,s),compensate:f,format:o,signal:c});for await(let i of r)a.put(i.chunk,{texels:i.texels,firstRow:i.firstRow},i.prefix),await n.rest(),!(performance.now()-l<(s.uploadInterval??j))&&(await a.show(n),s.onUpload?.(a.shown),l=performance.now());await a.show(n),s.onUpload?.(a.shown)}function W(e,o,t){return F(o,t,e.info.splats)}var k=class{scene;target;compensate;shown=0;rows=0;prefix=0;chunks=new Map;fresh=new Set;shownPrefix=-1;constructor(o,t,s){this.scene=o,this.target=t,this.compensate=s}put(o,t,s){this.chunks.set(o,t),this.fresh.add(o),this.rows=Math.max(this.rows,t.firstRow+t.texels.count),this.prefix=s}async show(o){let t=this.prefix,s=this.compensate&&t!==this.shownPrefix?[...this.chunks.keys()]:[...this.fresh];if(s.length!==0){for(let c of s){let{texels:f,firstRow:a}=this.chunks.get(c),n=this.compensate&&c<t?this.scene.compensation.shifts(t,c):void 0;G(f,n,this.target.arrays,a),await o.rest()}this.fresh.clear(),this.shownPrefix=t,this.shown=this.rows,(!this.compensate||t===this.scene.index.totalChunkCount)&&this.chunks.clear(),this.target.upload(this.rows)}}},L=class{since=performance.now();async rest(){performance.now()-this.since<J||(await new Promise(o=>setTimeout(o,0)),this.since=performance.now())}};function z(e){let o=new AbortController;return e?.aborted?o.abort(e.reason):e?.addEventListener("abort",()=>o.abort(e.reason),{once:!0}),o}function V(e,{worldOrigin:o}){let t=e.info.origin.map((c,f)=>c-(o??e.info.origin)[f]),s=T(e.info.axes);return[0,1,2].map(c=>t.reduce((f,a,n)=>f+s[3*c+n]*a,0))}var Z=`
uint cogsRotation;
vec4 cogsScale;
vec3 getCenter() {
  uvec4 transform = loadTransformA();
  cogsRotation = transform.w;
  cogsScale = loadTransformB();
  return uintBitsToFloat(transform.xyz);
}
vec4 getColor() { return loadDcColor(); }
vec3 getScale() { return cogsScale.xyz; }
vec4 getRotation() {
  vec3 s = (vec3((uvec3(cogsRotation) >> uvec3(0u, 10u, 20u)) & 1023u) / 511.5 - 1.0) * 0.70710678;
  float rest = sqrt(max(0.0, 1.0 - dot(s, s)));
  uint largest = cogsRotation >> 30u;
  if (largest == 0u) return vec4(rest, s);
  if (largest == 1u) return vec4(s.x, rest, s.yz);
  return largest == 2u ? vec4(s.xy, rest, s.z) : vec4(s, rest);
}
#include "gsplatUncompressedSHVS"
`,tt=`
var<private> cogsRotation: u32;
var<private> cogsScale: vec4f;
fn getCenter() -> vec3f {
  let transform: vec4<u32> = loadTransformA();
  cogsRotation = transform.w;
  cogsScale = loadTransformB();
  return bitcast<vec3f>(transform.xyz);
}
fn getColor() -> vec4f { return loadDcColor(); }
fn getScale() -> vec3f { return cogsScale.xyz; }
fn getRotation() -> vec4f {
  let s = (vec3f((vec3u(cogsRotation) >> vec3u(0u, 10u, 20u)) & vec3u(1023u)) / 511.5 - 1.0) * 0.70710678;
  let rest = sqrt(max(0.0, 1.0 - dot(s, s)));
  let largest = cogsRotation >> 30u;
  if (largest == 0u) { return vec4f(rest, s); }
  if (largest == 1u) { return vec4f(s.x, rest, s.yz); }
  if (largest == 2u) { return vec4f(s.xy, rest, s.z); }
  return vec4f(s, rest);
}
#include "gsplatUncompressedSHVS"
`;function At(e,o,t,s={}){let c=_(e,s),f=R("playcanvas",c),a=W(e,"playcanvas",c),n=f.map(({name:u,width:A,bytes:x})=>({name:u,format:x===2?o.PIXELFORMAT_RGBA16F:A===1?o.PIXELFORMAT_R32U:o.PIXELFORMAT_RGBA32U})),l=new o.GSplatFormat(t,n,{readGLSL:Z,readWGSL:tt}),r=new o.GSplatContainer(t,Math.max(1,e.info.splats),l);r.configureMaterialDefines=u=>u.set("SH_BANDS",String(c)),r.gsplatData.shBands=c;let{box:i}=e.info,[p,h]=[[0,1,2].map(u=>(i[u]+i[u+3])/2),[0,1,2].map(u=>(i[u+3]-i[u])/2)];r.aabb.center.set(p[0],p[1],p[2]),r.aabb.halfExtents.set(h[0],h[1],h[2]),r.update(0);let M=a[1],q=new Float32Array(M.buffer,M.byteOffset,M.length),K=u=>{f.forEach(({name:x},d)=>{let H=r.getTexture(x);H.lock().set(a[d]),H.unlock()});let{centers:A}=r;for(let x=0;x<u;x++)for(let d=0;d<3;d++)A[3*x+d]=q[4*x+d];r.update(u,!0)},C=z(s.signal),X=N(e,"playcanvas",{arrays:a,upload:K},s,C.signal);return{resource:r,rotation:I(e.info.axes),position:V(e,s),done:X,dispose(){C.abort(),r.destroy()}}}export{At as streamToPlayCanvas};
